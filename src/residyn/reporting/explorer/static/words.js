// Numbers and verdicts in words.

/** How many times, to two digits: 0.98 reads "1.0". Python: numbers.times. */
export function times(x) {
  if (x === null || !Number.isFinite(x)) return "?";
  if (x >= 9.95) return x.toFixed(0);
  return x >= 0.1 ? x.toFixed(1) : x.toPrecision(2);
}

/** A probability: never 100 %, as nothing measured is certain. */
export function percent(p) {
  if (p > 0.995) return ">\u00a099\u00a0%";
  return p < 0.005 ? "<\u00a01\u00a0%" : `${(100 * p).toFixed(0)}\u00a0%`;
}

/** A number with some digits, without an exponent where that can be. */
export function plain(x, digits = 4) {
  if (x === null || !Number.isFinite(x)) return "?";
  if (x === 0) return "0";
  const size = Math.abs(x);
  if (size < 1e-4 || size >= 1e6) return x.toExponential(digits - 1);
  return String(Number(x.toPrecision(digits)));
}

/** A value with its standard error: digits end where the error begins. */
export function measured(value, std, unit) {
  const short = unit === "1" ? "" : ` ${unit.replace(/\^2/g, "²").replace(/\^3/g, "³")}`;
  if (std === null || std === undefined || !Number.isFinite(std) || std <= 0) {
    return `${plain(value)}${short}`;
  }
  const places = Math.max(0, Math.min(9, 1 - Math.floor(Math.log10(std))));
  const shown = value.toFixed(places).replace(/^-(?=[0.]+$)/, ""); // nothing has no sign
  return `${shown} ± ${std.toFixed(places)}${short}`;
}

/** "rate, rad/s"; "rate" where the unit is not known. */
export function inUnit(what, unit, after = "") {
  return unit ? `${what}, ${unit}${after}` : what;
}

/** What acts at joints in "rad" or "m", or is in "N m" or "N": "force" where all of them slide. */
export function force(units) {
  return units.every((unit) => unit === "m" || unit === "N") ? "force" : "torque";
}

/** What is read of joints in "rad" or "m": "position" where all of them slide. */
export function position(units) {
  return units.every((unit) => unit === "m") ? "position" : "angle";
}

/** "a, b and c". */
export function listed(words) {
  if (words.length < 2) return words.join("");
  return `${words.slice(0, -1).join(", ")} and ${words.at(-1)}`;
}

/** "cubic stiffness at the elbow", inside a sentence. */
export function placed(candidate, joints) {
  const { spoken, place } = candidate;
  if (place === null) return spoken;
  if (joints.length === 1 && joints.includes(place)) return spoken;
  return joints.includes(place) ? `${spoken} at the ${place}` : `${spoken}, ${place}`;
}

/** How the model that is shown came to be; `sticks`: whether a joint may stick with it. */
export function standing({ how, fitted }, sticks, working) {
  const words = {
    refitted: "refitted: every number of this model by least squares",
    smoothed: `refitted: least squares by the smoother${sticks ? "; where a joint sticks, to a first approximation" : ""}`,
    "first order": fitted
      ? "first order: predicted, nothing fitted yet"
      : `no first-order answer: where a joint sticks nothing is linear${working ? "" : "; residyn explore fits it"}`,
  };
  return words[how] + (working ? `; ${working} ...` : "");
}

const NOISE = 1.1; // times the noise: up to here nothing is left that one could see

/** How an error changes: ["falls", "from 9.1 to 1.0"] or ["stays", "at 9.1"]. */
function change(from, to) {
  const verb = to < 0.98 * from ? "falls" : to > 1.02 * from ? "rises" : "stays";
  return [verb, verb === "stays" ? `at ${times(to)}` : `from ${times(from)} to ${times(to)}`];
}

/** The verdict on the model that is shown: `{ good, words }`. */
export function verdict({ model, base, chosen, candidates, joints, heldOut, likeliest, found }) {
  const names = chosen.map((label) => placed(candidates.get(label), joints));
  if (model.how === "by hand") return { good: false, words: ["Numbers as you set them."] };
  if (!model.fitted) {
    const whose = names.length ? `With ${listed(names)}` : "Of springs and dampers";
    return { good: false, words: [`${whose} the error is not known before a fit.`] };
  }
  const top = (errors) => errors.indexOf(Math.max(...errors));
  const noise = joints.every(
    (_, j) => model.fitted[j] <= NOISE && (!model.held_out || model.held_out[j] <= NOISE),
  );
  const missing = found?.coloured
    ? "noise that is not white, or something is still missing"
    : "something is missing";
  const words = found?.check ? [found.check] : [];
  const good = noise && found?.verdict !== "unexplained";
  if (!chosen.length) {
    const each = joints.map(
      (joint, j) => `${times(model.fitted[j])} times the noise at the ${joint}`,
    );
    words.push(
      good
        ? "Springs and dampers leave nothing but noise: nothing is missing."
        : `Springs and dampers leave ${listed(each)}${noise ? "" : `: ${missing}`}.`,
    );
  } else {
    const j = top(base.fitted);
    const [verb, sizes] = change(base.fitted[j], model.fitted[j]);
    let falls = `With ${listed(names)} the error at the ${joints[j]} `;
    falls += `${verb} ${sizes} times the noise`;
    if (base.held_out && model.held_out) {
      const [again, held] = change(base.held_out[j], model.held_out[j]);
      falls += `, and on ${heldOut === "last third" ? "the last third, held out," : "the held-out recordings"}`;
      falls += again === verb ? ` ${held}` : ` it ${again} ${held}`;
    }
    words.push(`${falls}.`);
    if (!noise) {
      words.push(found?.coloured ? `What is left is ${missing}.` : "Something is still missing.");
    } else if (good) words.push("Nothing is left but noise.");
  }
  if (noise && !good) {
    const sure = percent(found.probability);
    words.push(`Yet no effect that was tried explains all of these readings (${sure}).`);
  }
  if (!noise && likeliest && !found?.check) {
    const { label } = likeliest;
    const name = label ? placed(candidates.get(label), joints) : "a law without a name";
    const sure = likeliest.exact ? "" : ", to first order";
    words.push(`Most probable next: ${name} (${percent(likeliest.probability)}${sure}).`);
  }
  if (noise && found?.lookalikes.length) {
    const group = found.lookalikes.find((g) => g.some((x) => chosen.includes(x)));
    if (group) {
      const rest = group.filter((x) => !chosen.includes(x) && candidates.has(x));
      const alike = rest.map((x) => placed(candidates.get(x), joints));
      if (alike.length) words.push(`These recordings cannot tell it from ${listed(alike)}.`);
    }
  }
  if (noise && found?.next) words.push(found.next);
  return { good, words };
}
