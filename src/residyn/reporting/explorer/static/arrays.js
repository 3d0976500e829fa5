// Messages as they are sent, and the arrays in them.

/** The bytes of a number apart, the first ones of all first, as whole numbers side by side. */
function joined(bytes, at, count, size) {
  const found = new Uint8Array(count * size);
  for (let b = 0; b < size; b++) {
    for (let k = 0; k < count; k++) found[k * size + b] = bytes[at + b * count + k];
  }
  return found.buffer;
}

/** Numbers of 16 bits from their second differences along rows; what was not finite is NaN. */
function drawnValues(steps, width, scale) {
  const found = new Float64Array(steps.length);
  const whole = new Int16Array(1);
  for (let first = 0; first < steps.length; first += width) {
    let [value, slope] = [0, 0];
    for (let k = first; k < first + width; k++) {
      slope += steps[k];
      value += slope;
      whole[0] = value; // modulo 2^16
      found[k] = whole[0] === -32768 ? NaN : whole[0] * scale;
    }
  }
  return found;
}

/**
 * A message of the server or of a report: its tree, with arrays as { values, shape }. Python:
 * payload.packed.
 */
export async function opened(message) {
  if (!message.tree) return message;
  const packed = Uint8Array.from(atob(message.bytes), (letter) => letter.charCodeAt(0));
  const { readable, writable } = new DecompressionStream("deflate");
  const writer = writable.getWriter(); // not by a Blob, which goes through another process
  writer.write(packed);
  writer.close();
  const bytes = new Uint8Array(await new Response(readable).arrayBuffer());
  const walk = (x) => {
    if (Array.isArray(x)) return x.map(walk);
    if (x === null || typeof x !== "object") return x;
    if (x.at === undefined) {
      return Object.fromEntries(Object.entries(x).map(([key, value]) => [key, walk(value)]));
    }
    const count = x.shape.reduce((product, n) => product * n, 1);
    const values =
      x.scale === undefined
        ? new Float64Array(joined(bytes, x.at, count, 8))
        : drawnValues(new Uint16Array(joined(bytes, x.at, count, 2)), x.shape.at(-1), x.scale);
    return { values, shape: x.shape };
  };
  return walk(message.tree);
}

/** The rows of an array of two dimensions. */
export function rows({ values, shape }) {
  const width = shape[1];
  return Array.from({ length: shape[0] }, (_, i) => values.subarray(i * width, (i + 1) * width));
}

/** A symmetric matrix of n rows, of which the upper triangle stands by rows, as a function. */
export function symmetric(upper, n) {
  return (i, j) => {
    const [a, b] = i < j ? [i, j] : [j, i];
    return upper[a * n - (a * (a - 1)) / 2 + (b - a)];
  };
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
