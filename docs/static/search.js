// Guides stand before pages that a program wrote: hands of the zoo, examples, names of the API.
const WRITTEN = /(^|\/)(zoo|gallery|reference)\/generated\//;
// Words that are searched for: a page that has more of them in its title stands before others.
const ASKED = (new URLSearchParams(location.search).get("q") || "").toLowerCase().match(/\S+/g) || [];

var Scorer = {
  // [docname, title, anchor, description, score, filename, kind]
  score: ([page, title, , , score]) =>
    score +
    20 * ASKED.filter((word) => title.toLowerCase().includes(word)).length -
    (WRITTEN.test(page) ? 1000 : 0),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
