// Joints that move together: C q = d kept while one of them is moved by hand.
"use strict";

// The joints nearest to q, in shares of their ranges, with q[moved] as near to `value` as ranges and
// couplings allow. Arguments: q, lower, upper (nq); rows C (k x nq); values d (k). Returns a new q.
// What no coupling ties to the moved joint stays where it is.
function movedTogether(q, moved, value, lower, upper, rows, values) {
  const target = Math.min(upper[moved], Math.max(lower[moved], value));
  const tied = tiedTo(moved, rows);
  if (tied.rows.length === 0) {
    const alone = q.slice();
    alone[moved] = target;
    return alone;
  }
  const reach = (share) => settled(q, moved, q[moved] + share * (target - q[moved]), lower, upper,
    tied, rows, values);
  const whole = reach(1.0);
  if (whole !== null) return whole;
  let best = q.slice(), low = 0.0, high = 1.0; // as far as the others can follow
  for (let k = 0; k < 24; k++) {
    const middle = 0.5 * (low + high), found = reach(middle);
    if (found === null) high = middle;
    else [best, low] = [found, middle];
  }
  return best;
}

// Couplings and joints that hang together with a joint, over any number of couplings.
function tiedTo(joint, rows) {
  const joints = new Set([joint]), taken = new Set();
  for (let grown = true; grown;) {
    grown = false;
    rows.forEach((row, k) => {
      if (taken.has(k) || !row.some((c, j) => c !== 0 && joints.has(j))) return;
      taken.add(k);
      grown = true;
      row.forEach((c, j) => { if (c !== 0) joints.add(j); });
    });
  }
  return { joints: [...joints], rows: [...taken] };
}

// The nearest joints with one of them fixed; null if ranges and couplings do not allow it.
function settled(q, moved, value, lower, upper, tied, rows, values) {
  const fixed = new Map([[moved, value]]);
  for (let round = 0; round <= tied.joints.length; round++) {
    const found = q.slice();
    fixed.forEach((v, j) => { found[j] = v; });
    const free = tied.joints.filter((j) => !fixed.has(j));
    const span = free.map((j) => Math.max(upper[j] - lower[j], 1e-9));
    const matrix = tied.rows.map((k) => free.map((j, i) => rows[k][j] * span[i]));
    const rest = tied.rows.map((k) => values[k] - rows[k].reduce((s, c, j) => s + c * found[j], 0));
    const step = leastNorm(matrix, rest);
    if (step === null) return null;
    free.forEach((j, i) => { found[j] += span[i] * step[i]; });
    let worst = -1, most = 1e-9;
    free.forEach((j, i) => {
      const over = Math.max(lower[j] - found[j], found[j] - upper[j]) / span[i];
      if (over > most) [worst, most] = [j, over];
    });
    if (worst < 0) return found;
    fixed.set(worst, found[worst] < lower[worst] ? lower[worst] : upper[worst]);
  }
  return null;
}

// The shortest x with A x = b, by conjugate gradients on A A' y = b; null if there is none.
function leastNorm(matrix, b) {
  const columns = matrix.length ? matrix[0].length : 0;
  const up = (y) => Array.from({ length: columns }, (_, j) =>
    matrix.reduce((s, row, i) => s + row[j] * y[i], 0));
  const down = (x) => matrix.map((row) => row.reduce((s, a, j) => s + a * x[j], 0));
  const dot = (a, c) => a.reduce((s, v, i) => s + v * c[i], 0);
  const y = b.map(() => 0), r = b.slice();
  let p = r.slice(), size = dot(r, r);
  for (let k = 0; k < 4 * b.length && size > 1e-26; k++) {
    const image = down(up(p)), bend = dot(p, image);
    if (bend <= 1e-300) break;
    const step = size / bend;
    for (let i = 0; i < y.length; i++) { y[i] += step * p[i]; r[i] -= step * image[i]; }
    const next = dot(r, r);
    p = r.map((v, i) => v + (next / size) * p[i]);
    size = next;
  }
  return size > 1e-14 ? null : up(y);
}
