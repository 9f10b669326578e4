"use strict";
/* Starts the grid of a dataset: its columns and its models, then the pictures as they are asked for. */
async function ask(address) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(await answer.text());
  return answer;
}

(async function () {
  const root = document.getElementById("grid");
  try {
    const asked = [ask("rows"), ask("models")];
    const data = await (await asked[0]).json();
    let thumbnailer = null;
    try {
      const models = Opposable.decode(await (await asked[1]).arrayBuffer());
      thumbnailer = new Opposable.Thumbnailer(models, CARD.width, CARD.height - CAPTION);
    } catch (error) { // no WebGL, or a hand or mesh that has gone
      element("p", "grid-complaint", root, `There are no thumbnails: ${error.message}`);
    }
    Opposable.grid = new Grid(root, data, thumbnailer && ((pose) => thumbnailer.draw(pose)));
  } catch (error) {
    element("p", "grid-complaint", root, error.message);
    Opposable.errors.push(error.message);
  }
  document.documentElement.dataset.ready = "yes";
})();
