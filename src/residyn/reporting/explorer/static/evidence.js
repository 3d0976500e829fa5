// Which effects are probable: first-order evidence from the screen's Gram matrices, and the exact
// evidence of the models that the search has tried.

import { symmetric } from "./arrays.js";
import { logFactorial, logNormal, logSumExp, subset } from "./linear_algebra.js";

/** One name for a set of effects. */
export function keyOf(labels) {
  return [...labels].sort().join(" + ");
}

/** What half-normal priors add, of an effect whose columns begin at one of those of a posterior. */
function ofSigns(effect, { mean, spread }, first) {
  let sum = 0;
  effect.strengths.forEach((strength, i) => {
    if (strength.signed) sum += Math.LN2 + logNormal(mean[first + i] / spread[first + i]);
  });
  return sum;
}

export class Evidence {
  constructor(data) {
    this.candidates = new Map(data.candidates.map((c) => [c.label, c]));
    this.weights = data.screen.weights;
    this.grams = data.screen.grams.map((g) => symmetric(g.values, data.screen.size));
    this.prior = data.prior;
    this.tried = new Map();
    this.screened = new Map();
    this.keep(data);
  }

  /**
   * Take in models that were tried, the first order beside those that were extended, and by how much
   * laws without a name raise the log posterior beside some.
   */
  keep({ tried, screened, unnamed }) {
    this.known = new Map();
    this.unnamed = unnamed;
    for (const beside of screened) this.screened.set(keyOf(beside.added), beside.gains);
    for (const model of tried) this.tried.set(keyOf(model.added), model.log_evidence);
  }

  /** Log prior of a set of so many effects; Python: evidence.log_prior_model. */
  logPrior(count) {
    const { further, candidates } = this.prior;
    const sets = logFactorial(candidates) - logFactorial(count) - logFactorial(candidates - count);
    return Math.log(1 - further) + count * Math.log(further) - sets;
  }

  /**
   * By how much effects together raise the log evidence, to first order, each at given columns:
   * [label, columns] pairs. Also the posterior mean of the columns, and its spread, at the
   * likeliest random torque. Python: Screen.gain.
   */
  gainOf(pairs) {
    const columns = pairs.flatMap(([, which]) => which);
    if (!columns.length)
      return { gain: logSumExp(this.weights), mean: [], spread: [], likeliest: 0 };
    const each = this.grams.map((gram, k) => {
      const found = subset(gram, columns);
      let gain = found.gain + this.weights[k];
      let first = 0;
      for (const [label, which] of pairs) {
        const own = this.candidates.get(label);
        if (own.sizes.length) {
          const each = own.sizes.map((size) => {
            const scale = new Map(which.map((column, i) => [column + 1, size.ratio[i]]));
            const times = (row) => scale.get(row) ?? 1;
            const sized = subset((a, b) => times(a) * times(b) * gram(a, b), columns);
            return size.log_prior + sized.gain + ofSigns(own, sized, first);
          });
          gain += logSumExp(each) - found.gain;
        } else if (!own.oscillates) {
          gain += ofSigns(own, found, first);
        }
        first += which.length;
      }
      return { ...found, gain };
    });
    const gains = each.map((e) => e.gain);
    const likeliest = gains.indexOf(Math.max(...gains));
    return { ...each[likeliest], gain: logSumExp(gains), likeliest };
  }

  /** [label, columns] of effects at their likeliest shapes. */
  best(labels) {
    return labels.map((label) => {
      const own = this.candidates.get(label);
      return [label, own.rows[own.best]];
    });
  }

  /** `gainOf` effects at their likeliest shapes. */
  gain(labels) {
    return this.gainOf(this.best(labels));
  }

  /** Gain of one more effect beside others, its shapes averaged over their grid. */
  gainOfOneMore(labels, label) {
    const others = this.best(labels);
    const own = this.candidates.get(label);
    const gains = own.rows.map((which) => this.gainOf([...others, [label, which]]).gain);
    return logSumExp(gains) - Math.log(gains.length);
  }

  /** Whether two effects are not meant to be in a model together: one's law contains the other's. */
  conflict(a, b) {
    const [one, other] = [this.candidates.get(a), this.candidates.get(b)];
    return one.place === other.place && (one.extends === other.name || other.extends === one.name);
  }

  /**
   * Label -> { probability, exact }: for each effect outside the chosen set, that it is the one to
   * add next, where nothing more and a law without a name are choices too; for each inside, that the model is better with it
   * than without it. What was not tried is known to first order, about this model if the search has
   * extended it, else about the base model, corrected by what the search found for the effect alone;
   * with an effect by which a joint may stick that says nothing, and the probability is null.
   */
  probabilities(chosen) {
    return this.about(chosen).each;
  }

  /** That a law without a name is to be added next. */
  ofUnnamed(chosen) {
    return this.about(chosen).unnamed;
  }

  about(chosen) {
    const here = keyOf(chosen);
    if (!this.known.has(here)) this.known.set(here, this.weighed(chosen, here));
    return this.known.get(here);
  }

  /** By how much the first order is wrong about an effect alone, as far as the search knows. */
  correction(label) {
    const alone = this.tried.get(label);
    return alone === undefined ? 0 : alone - this.gainOfOneMore([], label);
  }

  weighed(chosen, here) {
    const base = this.gain(chosen).gain;
    const known = this.tried.get(here);
    const linear = !chosen.some((label) => this.candidates.get(label).sticks);
    const stay = this.logPrior(chosen.length);
    const found = new Map();
    const further = [];
    for (const label of this.candidates.keys()) {
      if (chosen.includes(label)) continue;
      const rest = chosen.filter((c) => !this.conflict(label, c));
      const exact = known === undefined ? undefined : this.tried.get(keyOf([...rest, label]));
      let gain = exact === undefined ? this.screened.get(here)?.[label] : exact - known;
      if (gain === undefined && linear) {
        gain = this.gainOfOneMore(rest, label) - base + this.correction(label);
      }
      if (gain === undefined) found.set(label, { probability: null, exact: false });
      else further.push([label, gain + this.logPrior(rest.length + 1), exact !== undefined]);
    }
    const beside = this.unnamed.filter((law) => keyOf(law.beside) === here);
    const unnamed = logSumExp(beside.map((law) => stay + law.gain));
    const total = logSumExp([stay, unnamed, ...further.map(([, w]) => w)]);
    for (const [label, weight, exact] of further) {
      found.set(label, { probability: Math.exp(weight - total), exact });
    }
    for (const label of chosen) {
      const rest = chosen.filter((c) => c !== label);
      const without = this.tried.get(keyOf(rest));
      const exact = known !== undefined && without !== undefined;
      let gain = exact ? known - without : this.screened.get(keyOf(rest))?.[label];
      if (gain === undefined && linear) {
        gain = base - this.gain(rest).gain + this.correction(label);
      }
      const odds = gain + stay - this.logPrior(rest.length);
      const probability = gain === undefined ? null : 1 / (1 + Math.exp(-odds));
      found.set(label, { probability, exact });
    }
    return { each: found, unnamed: Math.exp(unnamed - total) };
  }
}
