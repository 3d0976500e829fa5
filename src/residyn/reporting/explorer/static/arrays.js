// Arrays as the payload has them: base64 of doubles, or of 16 bits and a scale.

function bytes(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
}

const unpacked = new WeakMap();

/** A flat array of numbers, not to be changed; what was not finite is NaN. */
export function flat(packed) {
  if (!unpacked.has(packed)) unpacked.set(packed, unpack(packed));
  return unpacked.get(packed);
}

function unpack(packed) {
  if (packed.f8 !== undefined) return new Float64Array(bytes(packed.f8));
  const whole = new Int16Array(bytes(packed.i2));
  return Float64Array.from(whole, (x) => (x === -32768 ? NaN : x * packed.scale));
}

/** The rows of an array of two dimensions. */
export function rows(packed) {
  const all = flat(packed);
  const width = packed.shape[1];
  return Array.from({ length: packed.shape[0] }, (_, i) => all.subarray(i * width, (i + 1) * width));
}

/** A symmetric matrix of n rows, packed by the rows of its upper triangle, as a function. */
export function symmetric(packed, n) {
  const all = flat(packed);
  return (i, j) => {
    const [a, b] = i < j ? [i, j] : [j, i];
    return all[a * n - (a * (a - 1)) / 2 + (b - a)];
  };
}

/** Square matrices, a function each, from an array (m, n, n) or (n, n). */
export function squares(packed) {
  const all = flat(packed);
  const n = packed.shape.at(-1);
  const count = packed.shape.length === 3 ? packed.shape[0] : 1;
  return Array.from({ length: count }, (_, k) => (i, j) => all[(k * n + i) * n + j]);
}

/** For drawing: null where there is no number. */
export function drawn(values) {
  return Array.from(values, (x) => (Number.isFinite(x) ? x : null));
}

/** Values at other instants, straight between the known ones; both times increase. */
export function at(time, values, wanted) {
  let k = 0;
  return Float64Array.from(wanted, (t) => {
    while (k < time.length - 2 && time[k + 1] < t) k++;
    const share = (t - time[k]) / (time[k + 1] - time[k]);
    return values[k] + Math.min(1, Math.max(0, share)) * (values[k + 1] - values[k]);
  });
}
