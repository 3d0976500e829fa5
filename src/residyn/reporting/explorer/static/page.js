// One experiment on the page: what is on it, and what follows from a click.

import { Bars } from "./bars.js";
import { colours } from "./charts.js";
import { Chips } from "./chips.js";
import { Curves } from "./curves.js";
import { action, element } from "./elements.js";
import { Evidence, keyOf } from "./evidence.js";
import { FirstOrder } from "./first_order.js";
import { lay } from "./layout.js";
import { Missing } from "./missing.js";
import { Models } from "./models.js";
import { News } from "./news.js";
import { Numbers } from "./numbers.js";
import { Refits } from "./refits.js";
import { Saving, command, toml } from "./saving.js";
import { Scale } from "./scale.js";
import { Staircase } from "./staircase.js";
import { State } from "./state.js";
import { Stretch } from "./stretch.js";
import { Tabs } from "./tabs.js";
import { placed, standing, verdict } from "./words.js";

const LIKELY = 0.05; // a probability that is worth naming

export class Page {
  /** `server` and `open(study, hidden)`: null in a report. */
  constructor(root, data, server = null, open = null, hidden = false) {
    Object.assign(this, { root, data, server, open });
    this.evidence = new Evidence(data);
    this.models = new Models(this.evidence, new FirstOrder(data, this.evidence));
    this.models.keep(data.fits);
    this.fetched = data.known; // fits that the server has told of
    this.colours = colours(root);
    this.state = new State({
      chosen: [],
      held: new Map(),
      model: null,
      working: "",
      stretch: null,
      recording: 0,
      joint: 0,
      steps: [],
      found: data.verdict,
      error: "",
    });
    if (server) {
      this.refits = new Refits(server, this.state, this.models);
      this.news = new News(server, this, open, hidden);
    }
    this.build();
    this.follow();
    this.state.set({ joint: this.missing.loudest() });
    const way = server || !data.verdict ? [] : data.verdict.added;
    for (let k = 0; k <= way.length; k++) this.choose(way.slice(0, k));
    this.news?.follow();
  }

  // -- what follows from what --------------------------------------------------------------------

  follow() {
    const { state } = this;
    const { values } = state;
    state.on(["chosen"], () => this.refits?.chosen()); // first: the server works while the page draws
    state.on(["model", "found", "error"], () => this.drawModel());
    state.on(["chosen", "found"], () => this.drawChips());
    state.on(["model", "recording", "stretch"], () => {
      this.curves.draw(values.model, values.recording, values.stretch);
    });
    state.on(["model", "recording", "stretch", "joint"], () => {
      if (values.model) {
        this.missing.draw(values.model, values.recording, values.joint, values.stretch);
      }
    });
    state.on(["model", "working", "error"], () => this.drawStatus());
    state.on(["model", "recording", "joint", "stretch"], () => {
      this.recordings.draw(values.recording);
      this.joints.draw(values.joint);
      this.stretch.draw(values.stretch, this.curves.last(values.recording));
    });
  }

  /** Show a model. */
  choose(labels) {
    const chosen = [...labels].filter((x) => this.evidence.candidates.has(x));
    const model = this.models.of(chosen);
    const steps = this.state.get("steps");
    const key = keyOf(chosen);
    const seen = steps.some((s) => s.key === key);
    this.state.set({
      chosen,
      held: new Map(),
      model,
      working: "",
      error: "",
      steps: seen ? steps : [...steps, { key, labels: chosen }],
    });
  }

  toggle(label) {
    this.choose(this.models.toggled(this.state.get("chosen"), label));
  }

  hold(name, value) {
    if (this.refits.hold(name, value)) return;
    this.choose(this.state.get("chosen"));
  }

  /** Take in what the search has added. */
  learn(news) {
    this.models.keep(news.fits);
    this.fetched = news.known;
    this.evidence.keep(news);
    const { chosen, held, model } = this.state.values;
    const better = this.models.of(chosen);
    if (better.how !== "first order" && model.how !== "refitted" && !held.size) {
      this.state.set({ model: better });
    }
    this.drawModel();
    this.drawChips();
    this.state.set({ found: news.verdict });
  }

  complain(error) {
    this.state.set({ working: "", error });
  }

  async hide() {
    this.state.set({ working: "hiding an effect in a simulated arm" });
    const found = await this.server.post("hide", {});
    if (found.error) return this.complain(found.error);
    await this.open(found.study, true);
  }

  chosen() {
    return this.state.get("chosen");
  }

  /** An effect in words. */
  name(label) {
    const own = this.evidence.candidates.get(label);
    return own ? placed(own, this.data.joints) : label;
  }

  get line() {
    return command(this.data.name, [...this.data.with, ...this.chosen()]);
  }

  // -- what is on it -------------------------------------------------------------------------

  build() {
    const { data, state, server } = this;
    const shared = {
      onStretch: (stretch) => state.set({ stretch }),
      colours: () => this.colours,
    };
    this.verdict = element("p", { class: "verdict", "aria-live": "polite" });
    this.status = element("p", { class: "status", role: "status" });
    this.chips = new Chips(this.evidence.candidates, (label) => this.toggle(label));
    this.scale = new Scale();
    this.bars = new Bars(data.joints, data.held_out, this.scale);
    this.stairs = new Staircase(data.joints, this.scale, {
      onChoose: (labels) => this.choose(labels),
      nameOf: (label) => this.name(label),
    });
    const names = data.recordings.map((r) =>
      r.role === "check" ? `${r.name} (held out)` : r.name,
    );
    this.recordings = new Tabs(names, "recordings", (recording) =>
      state.set({ recording, stretch: null }),
    );
    this.joints = new Tabs(data.joints, "joints", (joint) => state.set({ joint }));
    this.stretch = new Stretch(shared.onStretch);
    this.curves = new Curves(data, shared);
    this.missing = new Missing(data, { ...shared, joint: () => state.get("joint") });
    this.numbers = new Numbers({
      live: server !== null,
      onMove: (name, value) => this.refits.move(name, value),
      onHold: (name, value) => this.hold(name, value),
    });
    this.saving = new Saving(
      () => this.line,
      () => toml(data.toml, this.line, state.get("model").numbers),
    );
    const hide = server ? action("Hide one", () => this.hide()) : null;
    lay(this.root, this, hide);
    this.root.hidden = false;
    this.charts = [...this.curves.charts, ...this.missing.charts];
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.recolour = () => {
      this.colours = colours(this.root);
      for (const chart of this.charts) chart.redraw();
    };
    this.scheme.addEventListener("change", this.recolour);
  }

  destroy() {
    this.news?.stop();
    this.refits?.stop();
    this.scheme.removeEventListener("change", this.recolour);
    for (const chart of this.charts) chart.destroy();
  }

  // -- drawing -------------------------------------------------------------------------------

  /** Whether a probability is worth showing: until the search has looked, the first order alone
   * names nobody. */
  weighed(exact) {
    return exact || Boolean(this.state.get("found")) || !this.server || this.news.ended;
  }

  drawChips() {
    const chosen = this.chosen();
    this.chips.draw(chosen, this.evidence.probabilities(chosen), (exact) => this.weighed(exact));
  }

  drawModel() {
    const { model, chosen, held, steps, found, error } = this.state.values;
    const seen = steps.map((s) => ({ ...s, model: this.models.of(s.labels) }));
    this.scale.hold([model, this.models.base, ...seen.map((s) => s.model)]);
    this.bars.draw(model, this.models.base);
    this.stairs.draw(seen, keyOf(chosen));
    this.numbers.draw(model, held);
    const told = verdict({
      model: held.size ? { ...model, how: "by hand" } : model,
      base: this.models.base,
      chosen,
      candidates: this.evidence.candidates,
      joints: this.data.joints,
      heldOut: this.data.held_out,
      likeliest: this.likeliest(chosen),
      found,
    });
    this.verdict.textContent = error
      ? `${error[0].toUpperCase()}${error.slice(1)}`
      : told.words.join(" ");
    this.verdict.classList.toggle("good", told.good && !error);
  }

  /** { label, probability, exact } of what is most probable next, or null; a law without a name has
   * no label. */
  likeliest(chosen) {
    const unnamed = { label: null, probability: this.evidence.ofUnnamed(chosen), exact: true };
    const each = [...this.evidence.probabilities(chosen)]
      .filter(([label]) => !chosen.includes(label))
      .map(([label, found]) => ({ label, ...found }));
    const next = [...each, unnamed].sort((a, b) => b.probability - a.probability)[0];
    return next && this.weighed(next.exact) && next.probability > LIKELY ? next : null;
  }

  drawStatus() {
    const { model, working, error } = this.state.values;
    const kind = error ? "error" : working ? "working" : model.how.replace(" ", "-");
    this.status.className = `status ${kind}`;
    this.status.textContent = standing(model, this.models.sticks(model.added), working);
  }
}
