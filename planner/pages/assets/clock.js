"use strict";
/* The page's one time. Whatever moves or is drawn over time listens to it. */
Opposable.Clock = class {
  /** times: the samples, s, increasing. */
  constructor(times) {
    this.times = times;
    this.begin = times.length ? times[0] : 0;
    this.end = times.length ? times[times.length - 1] : 0;
    this.time = this.begin;
    this.speed = 1;
    this.playing = false;
    this.listeners = [];
    this.last = 0;
  }

  get moves() { return this.times.length > 1; }

  /** Number of the last sample that is not after the time. */
  get sample() {
    let low = 0, high = this.times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= this.time + 1e-9) low = middle; else high = middle - 1;
    }
    return low;
  }

  listen(listener) { this.listeners.push(listener); }
  tell() { for (const listener of this.listeners) listener(this); }

  seek(time) {
    this.time = Math.min(this.end, Math.max(this.begin, time));
    this.tell();
  }

  step(samples) {
    this.pause();
    const at = Math.min(this.times.length - 1, Math.max(0, this.sample + samples));
    this.seek(this.times[at]);
  }

  play() {
    if (!this.moves || this.playing) return;
    if (this.time >= this.end - 1e-9) this.time = this.begin;
    this.playing = true;
    this.last = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      this.time += (this.speed * Math.max(0, now - this.last)) / 1000;
      this.last = now;
      if (this.time >= this.end) {
        this.time = this.end;
        this.playing = false;
      } else requestAnimationFrame(tick);
      this.tell();
    };
    requestAnimationFrame(tick);
    this.tell();
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    this.tell();
  }

  toggle() { if (this.playing) this.pause(); else this.play(); }
};
