"use strict";
/* Play, step, speed, the slider, and the strip of phases and events above it. */
Opposable.timeline = function (scene, clock) {
  const get = (id) => document.getElementById(id);
  const transport = get("transport"), slider = get("slider"), strip = get("timeline");
  if (!clock.moves) return;
  transport.hidden = false;
  slider.min = clock.begin;
  slider.max = clock.end;
  slider.addEventListener("input", () => {
    clock.pause();
    clock.seek(Number(slider.value));
  });
  get("play").addEventListener("click", () => clock.toggle());
  get("back").addEventListener("click", () => clock.step(-1));
  get("forth").addEventListener("click", () => clock.step(1));
  get("speed").addEventListener("change", (event) => { clock.speed = Number(event.target.value); });

  const draw = () => {
    strip.replaceChildren();
    if (!scene.bands.length && !scene.marks.length) return;
    const width = strip.clientWidth, span = Math.max(1e-9, clock.end - clock.begin);
    const x = (t) => 8 + ((t - clock.begin) / span) * (width - 16);
    const svg = Opposable.svg("svg", { width, height: 24 }, strip);
    scene.bands.forEach((band, i) => {
      const left = x(band.begin), wide = Math.max(0, x(band.end) - left);
      const group = Opposable.svg("g", { class: i % 2 ? "phase odd" : "phase" }, svg);
      Opposable.svg("rect", { x: left, y: 2, width: wide, height: 20, rx: 3 }, group);
      Opposable.svg("title", {}, group,
        `${band.name}: ${band.begin.toFixed(2)} to ${band.end.toFixed(2)} s`);
      if (wide > 7 * band.name.length + 6) {
        Opposable.svg("text", { x: left + wide / 2, y: 16, class: "tick middle" }, group, band.name);
      }
      group.addEventListener("click", () => clock.seek(band.begin));
    });
    for (const mark of scene.marks) {
      const at = x(mark.time);
      const sign = Opposable.svg("path", {
        d: `M${at} 23l-5 -9h10z`, class: `sign ${mark.kind}`,
      }, svg);
      Opposable.svg("title", {}, sign, `${mark.text} (${mark.time.toFixed(2)} s)`);
      sign.addEventListener("click", () => clock.seek(mark.time));
    }
  };
  draw();
  new ResizeObserver(draw).observe(strip);

  const tell = () => {
    slider.value = clock.time;
    const band = scene.bands.find((b) => clock.time >= b.begin && clock.time <= b.end);
    get("clock").textContent =
      `${clock.time.toFixed(2)} / ${clock.end.toFixed(2)} s${band ? ` \u00b7 ${band.name}` : ""}`;
    const play = get("play");
    play.textContent = clock.playing ? "\u275a\u275a" : "\u25b6\ufe0e";
    play.setAttribute("aria-label", clock.playing ? "Pause" : "Play");
  };
  clock.listen(tell);
  tell();

  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest("input:not([type=range]), select, textarea");
    if (typing || event.ctrlKey || event.altKey || event.metaKey) return;
    const actions = {
      " ": () => clock.toggle(),
      ArrowLeft: () => clock.step(event.shiftKey ? -10 : -1),
      ArrowRight: () => clock.step(event.shiftKey ? 10 : 1),
      Home: () => clock.seek(clock.begin),
      End: () => clock.seek(clock.end),
    };
    if (!actions[event.key] || (event.key === " " && event.target.closest("button, summary"))) return;
    event.preventDefault();
    actions[event.key]();
  });
};
