// Exact fits of what is shown: asked of the server, the newest first, and numbers held by hand.

import { keyOf } from "./evidence.js";

const IDLE = 1500; // ms without a click, after which what is least squares already is refined
const WORKING = {
  smoothed: "refitting",
  predicted: "predicting what is held out",
  refitted: "refining",
  alone: "the smoother does not settle: refitting by simulation, which takes some seconds",
};

export class Refits {
  constructor(server, state, models) {
    Object.assign(this, { server, state, models });
    this.asked = null; // what is waited for now
    this.moving = null; // names of numbers that are held while a slider moves
  }

  /** Another model is shown: fit it and predict, if that was not done yet. */
  chosen() {
    this.asked = this.moving = null;
    const { how, held_out } = this.state.get("model");
    if (how !== "refitted" || !held_out) this.ask();
  }

  stop() {
    this.asked = {};
  }

  async ask() {
    const { chosen, held } = this.state.values;
    const known = this.models.fits.get(keyOf(chosen));
    const asked = {};
    this.asked = asked;
    for (const how of this.missing(known, held)) {
      const { model } = this.state.values;
      if (how === "predicted" && (model.how === "first order" || model.held_out)) continue;
      if (how === "refitted" && model.how === "smoothed") {
        await new Promise((resolve) => setTimeout(resolve, IDLE));
        if (asked !== this.asked) return;
      }
      const alone = how === "refitted" && model.how === "first order" && !held.size;
      this.state.set({ working: WORKING[alone ? "alone" : how] });
      let found;
      try {
        found = await this.server.fit(chosen, held, how);
      } catch {
        found = { error: "the server does not answer: has it been stopped?" };
      }
      if (found === null || asked !== this.asked) return; // something newer is under way
      if (found.error) return this.state.set({ working: "", error: found.error });
      if (found.fit === null) continue;
      if (!held.size) this.models.keep([found.fit]);
      this.state.set({ working: "", error: "", model: found.fit });
    }
  }

  /** What to ask for, one after the other. */
  missing(known, held) {
    if (this.moving) return ["refitted"];
    if (held.size) return ["refitted", "predicted"];
    if (known?.how === "refitted") return ["predicted"];
    return [...(known ? [] : ["smoothed"]), "predicted", "refitted", "predicted"];
  }

  /** A slider moves one number: all others stay meanwhile. */
  move(name, value) {
    const all = this.state.get("model").numbers.map((n) => [n.name, n.value]);
    const held = this.state.get("held");
    this.moving ??= new Set(held.keys());
    this.moving.add(name);
    this.state.set({ held: new Map([...all, ...held, [name, value]]) });
    this.ask();
  }

  /** A number is held at a value, or let go (null), and the others are fitted; false if none is
   * held any more. */
  hold(name, value) {
    const held = this.state.get("held");
    const names = this.moving ?? new Set(held.keys());
    this.moving = null;
    const next = new Map([...held].filter(([n]) => names.has(n) && n !== name));
    if (value !== null) next.set(name, value);
    this.state.set({ held: next });
    if (next.size) this.ask();
    return next.size > 0;
  }
}
