// Guides stand before pages that a program wrote: hands of the zoo, examples, names of the API.
const WRITTEN = /(^|\/)(zoo|gallery|reference)\/generated\//;

var Scorer = {
  // [docname, title, anchor, description, score, filename, kind]
  score: ([page, , , , score]) => (WRITTEN.test(page) ? score - 100 : score),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
