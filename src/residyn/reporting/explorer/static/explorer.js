// The page: what is on it, and what follows from a click.

import { drawn, opened, rows } from "./arrays.js";
import { Bars } from "./bars.js";
import { CloudChart, TimeChart, colours } from "./charts.js";
import { element, fill } from "./elements.js";
import { Evidence, keyOf } from "./evidence.js";
import { FirstOrder } from "./first_order.js";
import { Numbers } from "./numbers.js";
import { Server } from "./server.js";
import { Staircase } from "./staircase.js";
import { State } from "./state.js";
import { command, percent, placed, toml, verdict } from "./words.js";

const MOST_CHIPS = 8;
const IDLE = 1500; // ms
const root = document.getElementById("residyn-explorer");

/** One experiment on the page. */
class Page {
  constructor(data, server) {
    this.data = data;
    this.server = server;
    this.evidence = new Evidence(data);
    this.first = new FirstOrder(data, this.evidence);
    this.guesses = new Map(); // what the first order says, by model
    this.fits = new Map(); // by model
    this.found = data.verdict;
    this.keep(data.fits);
    this.fetched = data.known; // fits that the server has told of
    this.time = data.recordings.map((r) => r.time.values);
    this.angle = data.recordings.map((r) => rows(r.angle));
    this.missing = data.missing.map((m) => ({
      time: m.time.values,
      ...Object.fromEntries(
        ["angle", "rate", "amplitude", "torque", "std"].map((k) => [k, rows(m[k])]),
      ),
    }));
    this.state = new State({
      chosen: [],
      held: new Map(),
      model: null,
      working: "",
      stretch: null,
      recording: 0,
      joint: this.loudest(),
      steps: [],
      found: data.verdict,
      error: "",
    });
    this.colours = colours(root);
    this.build();
    this.charts = [];
    this.buildCharts();
    this.state.on(["model", "found"], () => this.drawModel());
    this.state.on(["model", "recording", "stretch"], () => this.drawCurves());
    this.state.on(["model", "recording", "stretch", "joint"], () => this.drawMissing());
    this.state.on(["model", "working", "error"], () => this.drawStatus());
    this.state.on(["chosen", "found"], () => this.drawChips());
    this.state.on(["recording", "joint", "stretch"], () => this.drawControls());
    const way = data.live || !data.verdict ? [] : data.verdict.added;
    for (let k = 0; k <= way.length; k++) this.choose(way.slice(0, k), true);
    this.drawChips();
    this.drawControls();
  }

  // -- models --------------------------------------------------------------------------------

  keep(fits) {
    for (const fit of fits) {
      const key = keyOf(fit.added);
      if (fit.how === "refitted" || !this.fits.has(key)) this.fits.set(key, fit);
    }
  }

  guess(labels) {
    const key = keyOf(labels);
    if (!this.guesses.has(key)) this.guesses.set(key, this.first.model(labels));
    return this.guesses.get(key);
  }

  /** The best that is known of a model now. */
  stored(labels) {
    const fit = this.fits.get(keyOf(labels));
    if (!fit) return this.guess(labels);
    return fit.torque ? fit : { ...fit, torque: this.guess(labels).torque };
  }

  get base() {
    return this.stored([]);
  }

  /** Show a model. */
  choose(labels, quietly = false) {
    this.asked = null;
    const known = [...labels].filter((x) => this.evidence.candidates.has(x));
    const model = this.stored(known);
    const steps = this.state.get("steps");
    const key = keyOf(known);
    const seen = steps.some((s) => s.key === key);
    this.state.set({
      chosen: known,
      held: new Map(),
      model,
      error: "",
      steps: seen ? steps : [...steps, { key, labels: known }],
    });
    if (quietly) this.drawStatus();
    if (this.server && model.how !== "refitted") this.refit();
  }

  toggle(label) {
    const chosen = this.state.get("chosen");
    if (chosen.includes(label)) return this.choose(chosen.filter((x) => x !== label));
    this.choose([...chosen.filter((x) => !this.evidence.conflict(x, label)), label]);
  }

  /** Whether a joint or a brake may stick with these effects. */
  rough(labels) {
    return labels.some((label) => this.evidence.candidates.get(label).rough);
  }

  /** Ask the server for the exact fit of what is shown. */
  async refit() {
    const { chosen, held } = this.state.values;
    const known = this.fits.get(keyOf(chosen));
    const asked = {};
    this.asked = asked;
    for (const quick of held.size || known ? [false] : [true, false]) {
      if (!quick && this.state.get("model").how === "smoothed" && !this.rough(chosen)) {
        // What is seen is least squares already; the rest waits until nobody clicks.
        await new Promise((resolve) => setTimeout(resolve, IDLE));
        if (asked !== this.asked) return;
      }
      this.state.set({ working: quick ? "refitting" : "refining" });
      let found;
      try {
        found = await this.server.fit(chosen, held, quick);
      } catch {
        found = { error: "the server does not answer: has it been stopped?" };
      }
      if (found === null) return; // something newer is under way
      if (found.error) return this.state.set({ working: "", error: found.error });
      if (found.fit === null) continue; // the smoother does not settle
      if (!held.size) this.keep([found.fit]);
      this.state.set({ working: "", error: "", model: found.fit });
    }
  }

  // -- numbers -------------------------------------------------------------------------------

  move(name, value) {
    const all = this.state.get("model").numbers.map((n) => [n.name, n.value]);
    const held = this.state.get("held");
    this.moving ??= new Set(held.keys());
    this.moving.add(name);
    this.state.set({ held: new Map([...all, ...held, [name, value]]) });
    this.refit();
  }

  hold(name, value) {
    const held = this.state.get("held");
    const names = this.moving ?? new Set(held.keys());
    this.moving = null;
    const next = new Map([...held].filter(([n]) => names.has(n) && n !== name));
    if (value !== null) next.set(name, value);
    this.state.set({ held: next });
    if (next.size) return this.refit();
    this.choose(this.state.get("chosen"));
  }

  // -- the page ------------------------------------------------------------------------------

  build() {
    const { data } = this;
    const button = (words, click, more = {}) =>
      element("button", { type: "button", class: "action", click, ...more }, words);
    this.verdict = element("p", { class: "verdict", "aria-live": "polite" });
    this.status = element("p", { class: "status", "aria-live": "polite" });
    this.chips = element("div", {
      class: "chips",
      role: "group",
      "aria-label": "most probable effects",
    });
    this.more = element("div", {
      class: "chips",
      role: "group",
      "aria-label": "all other effects",
    });
    this.moreTitle = element("summary", {});
    const barsPlace = element("div", { class: "bars" });
    const stairsPlace = element("div", {
      class: "stairs",
      role: "group",
      "aria-label": "models looked at",
    });
    const numbersPlace = element("div", {});
    this.tabs = element("div", { class: "tabs" });
    this.jointTabs = element("div", { class: "tabs" });
    this.from = this.slider("from", 0);
    this.to = this.slider("to", 1);
    this.whole = button("Whole recording", () => this.state.set({ stretch: null }));
    this.curves = element("div", { class: "curves" });
    this.clouds = element("div", { class: "clouds" });
    this.said = element("span", { class: "said", role: "status" });
    this.bars = new Bars(barsPlace, data.joints, data.held_out);
    this.stairs = new Staircase(
      stairsPlace,
      (labels) => this.choose(labels),
      (label) => this.name(label),
    );
    this.numbers = new Numbers(numbersPlace, {
      live: this.server !== null,
      onMove: (name, value) => this.move(name, value),
      onHold: (name, value) => this.hold(name, value),
    });
    const panel = (title, words, ...children) =>
      element(
        "section",
        { class: "panel" },
        element("h2", {}, title),
        words ? element("p", { class: "note" }, words) : null,
        ...children,
      );
    this.banner = element("div", { class: "banner", role: "status" });
    const hide = this.server
      ? button("Hide one", () => this.hide(), {
          title: "hide an effect in a simulated copy of this arm, and find it",
        })
      : null;
    fill(
      root,
      element(
        "header",
        {},
        element("p", { class: "kind" }, `residyn explore: ${data.name}`),
        this.verdict,
        this.status,
        this.banner,
      ),
      element(
        "div",
        { class: "columns" },
        panel(
          "Add an effect",
          "A click adds it to the model or takes it away. Each number: how probable it is that this is missing next.",
          this.chips,
          element("details", {}, this.moreTitle, this.more),
          element(
            "div",
            { class: "actions" },
            button("Copy as command", () => this.copy()),
            button("Save as TOML", () => this.save()),
            hide,
            this.said,
          ),
        ),
        panel(
          "Watch the error fall",
          "",
          barsPlace,
          element("h3", {}, "Models so far"),
          stairsPlace,
        ),
      ),
      panel(
        "Measured, model and what is left",
        "Drag across a chart to choose a stretch of time; it is marked everywhere.",
        element(
          "div",
          { class: "legend" },
          element("span", { class: "key measured" }, "measured"),
          element("span", { class: "key model" }, "model"),
          element("span", { class: "key residual" }, "measured less model"),
          element("span", { class: "key band" }, "noise, 2 sigma"),
        ),
        this.tabs,
        element(
          "div",
          { class: "stretch" },
          element("label", {}, "from ", this.from),
          element("label", {}, "to ", this.to),
          this.whole,
        ),
        this.curves,
      ),
      panel(
        "The torque that springs and dampers lack",
        "Grey: what the motion asks for, with the band in which it lies 19 times in 20. Blue: what the effects above would make of it. Friction is a step against the rate, a stiffening spring an S against the angle, hysteresis a loop.",
        this.jointTabs,
        this.clouds,
      ),
      panel(
        "Numbers",
        this.server
          ? "Move a number and the model's curve follows; the others are then fitted again beside it."
          : "",
        numbersPlace,
      ),
    );
    root.hidden = false;
    this.replaceTheRest(button);
  }

  /** In a report the page stands for all tables and pictures; a button shows them. */
  replaceTheRest(button) {
    if (!document.querySelector(".in-full")) return;
    const turn = (shown) => {
      document.body.classList.toggle("explored", !shown);
      more.setAttribute("aria-expanded", String(shown));
      more.textContent = shown ? "Hide tables and pictures" : "All tables and pictures";
    };
    const more = button("", () => turn(more.getAttribute("aria-expanded") === "false"));
    root.append(element("div", { class: "actions" }, more));
    turn(false);
  }

  slider(words, end) {
    return element("input", {
      type: "range",
      min: 0,
      max: 1000,
      step: 1,
      value: 1000 * end,
      "aria-label": `${words}, s`,
      input: () => {
        const last = this.time[this.state.get("recording")].at(-1);
        const [a, b] = [this.from, this.to].map((s) => (last * Number(s.value)) / 1000);
        this.state.set({
          stretch: Math.abs(b - a) < last / 200 ? null : [Math.min(a, b), Math.max(a, b)],
        });
      },
    });
  }

  name(label) {
    const own = this.evidence.candidates.get(label);
    return own ? placed(own, this.data.joints) : label;
  }

  buildCharts() {
    const { data } = this;
    const c = () => this.colours;
    const onStretch = (stretch) => this.state.set({ stretch });
    this.pairs = data.joints.map((joint, j) => {
      const place = [element("div", { class: "chart" }), element("div", { class: "chart" })];
      this.curves.append(element("div", {}, element("h3", {}, joint), ...place));
      const shared = { sync: "time", zoomed: true, onStretch, colours: c };
      const curves = new TimeChart(place[0], {
        ...shared,
        height: 190,
        label: `angle, ${data.units[j]}`,
        series: [
          { colour: "measured", width: 4 },
          { colour: "model", width: 1.5 },
        ],
      });
      const left = new TimeChart(place[1], {
        ...shared,
        height: 130,
        label: `left, ${data.units[j]}`,
        series: [{ width: 0, band: true }, { width: 0 }, { colour: "residual", width: 1.2 }],
      });
      return [curves, left];
    });
    const of =
      (words, after = "") =>
      () =>
        `${words}, ${data.units[this.state.get("joint")]}${after}`;
    const torque = () => `torque, ${data.missing[0].units[this.state.get("joint")]}`;
    const labels = { angle: of("angle"), rate: of("rate", "/s"), amplitude: of("amplitude") };
    const spot = (title, wide) => {
      const place = element("div", { class: "chart" });
      this.clouds.append(
        element("div", { class: wide ? "wide" : null }, element("h3", {}, title), place),
      );
      return place;
    };
    this.torque = new TimeChart(spot("against time", true), {
      height: 200,
      label: torque,
      zoomed: false,
      sync: "time",
      onStretch,
      colours: c,
      series: [
        { width: 0, band: true },
        { width: 0 },
        { colour: "measured", width: 1.2 },
        { colour: "model", width: 1.5 },
      ],
    });
    this.against = ["rate", "angle", "amplitude"].map((what) => [
      what,
      new CloudChart(spot(`against ${what}`), {
        height: 220,
        labels: [labels[what], torque],
        colours: c,
      }),
    ]);
    this.charts = [...this.pairs.flat(), this.torque, ...this.against.map(([, chart]) => chart)];
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.recolour = () => {
      this.colours = colours(root);
      for (const chart of this.charts) chart.redraw();
    };
    this.scheme.addEventListener("change", this.recolour);
  }

  destroy() {
    this.scheme.removeEventListener("change", this.recolour);
    for (const chart of this.charts) chart.destroy();
    this.gone = true;
  }

  /** The joint that lacks most, in its own bands. */
  loudest() {
    const share = this.missing[0].torque.map((row, j) => {
      const std = this.missing[0].std[j];
      return row.reduce((s, x, k) => s + Math.min(100, (x / std[k]) ** 2), 0);
    });
    return share.indexOf(Math.max(...share));
  }

  // -- drawing -------------------------------------------------------------------------------

  drawModel() {
    const { model, chosen, held, steps, found } = this.state.values;
    const { data } = this;
    this.bars.draw(model, this.base);
    this.numbers.draw(model, held);
    this.stairs.draw(
      steps.map((s) => ({ ...s, model: this.stored(s.labels) })),
      keyOf(chosen),
    );
    const best = [...this.evidence.probabilities(chosen)]
      .filter(([label]) => !chosen.includes(label))
      .sort((a, b) => b[1].probability - a[1].probability)[0];
    const weighed = best && (best[1].exact || found); // the first order alone names nobody
    const likeliest = weighed && best[1].probability > 0.05 ? { label: best[0], ...best[1] } : null;
    const shown = held.size ? { ...model, how: "by hand" } : model;
    const told = verdict({
      model: shown,
      base: this.base,
      chosen,
      candidates: this.evidence.candidates,
      joints: data.joints,
      heldOut: data.held_out,
      likeliest,
      found,
    });
    this.verdict.textContent = told.words.join(" ");
    this.verdict.classList.toggle("good", told.good);
  }

  drawStatus() {
    const { model, working, error } = this.state.values;
    const rough = this.rough(model.added);
    const words = {
      refitted: "refitted: every number of this model by least squares",
      smoothed: `refitted: least squares by the smoother${rough ? ", to about 1 % where a joint sticks" : ""}`,
      "first order": `first order: predicted, nothing fitted yet${rough ? "; where a joint sticks this can be far off" : ""}`,
    };
    this.status.className = `status ${error ? "error" : working ? "working" : model.how.replace(" ", "-")}`;
    const live = working ? `; ${working} ...` : "";
    this.status.textContent = error || `${words[model.how]}${live}`;
  }

  drawChips() {
    const { chosen } = this.state.values;
    const probabilities = this.evidence.probabilities(chosen);
    if (!this.order || this.ordered !== this.state.get("found") + this.evidence.tried.size) {
      const alone = this.evidence.probabilities([]);
      this.order = [...alone].sort((a, b) => b[1].probability - a[1].probability).map(([l]) => l);
      this.ordered = this.state.get("found") + this.evidence.tried.size;
    }
    const top = this.order.slice(0, MOST_CHIPS);
    const shown = [...top, ...chosen.filter((x) => !top.includes(x))];
    const rest = this.order.filter((x) => !shown.includes(x)).sort();
    const focused = document.activeElement?.dataset?.effect;
    const chip = (label) => {
      const own = this.evidence.candidates.get(label);
      const { probability, exact } = probabilities.get(label);
      const pressed = chosen.includes(label);
      const weighed = exact || this.state.get("found") || !this.server || this.stopped;
      const found = element(
        "button",
        {
          type: "button",
          class: "chip",
          "aria-pressed": String(pressed),
          "data-effect": label,
          title: [own.equation, own.looks_like, exact ? "" : "probability to first order"]
            .filter(Boolean)
            .join("; "),
          click: () => this.toggle(label),
        },
        element(
          "span",
          { class: "title" },
          own.title,
          own.place ? element("small", {}, ` ${own.place}`) : "",
        ),
        element("span", { class: "p" }, weighed ? percent(probability) : "being weighed"),
      );
      found.style.setProperty("--p", `${weighed ? 100 * probability : 0}%`);
      return found;
    };
    fill(this.chips, ...shown.map(chip));
    fill(this.more, ...rest.map(chip));
    this.moreTitle.textContent = `${rest.length} more effects and places`;
    if (focused) {
      [...root.querySelectorAll(".chip")].find((b) => b.dataset.effect === focused)?.focus();
    }
  }

  drawCurves() {
    const { model, recording, stretch } = this.state.values;
    const time = this.time[recording];
    const predicted = model.predicted
      ? model.predicted[recording]
      : this.curvesOf(model, recording);
    this.pairs.forEach(([curves, left], j) => {
      const measured = this.angle[recording][j];
      const own = predicted ? predicted[j] : measured.map(() => NaN);
      const noise = 2 * this.data.recordings[recording].noise[j];
      const x = Array.from(time);
      curves.draw([x, drawn(measured), drawn(own)], stretch);
      left.draw(
        [x, x.map(() => noise), x.map(() => -noise), drawn(measured.map((y, k) => y - own[k]))],
        stretch,
      );
    });
  }

  curvesOf(model, recording) {
    const packed = model.curves[recording];
    return packed ? rows(packed) : null;
  }

  drawMissing() {
    const { model, recording, joint, stretch } = this.state.values;
    const which = Math.min(recording, this.missing.length - 1);
    const own = this.missing[which];
    const [torque, std] = [own.torque[joint], own.std[joint]];
    const time = Array.from(own.time);
    let blue = null;
    if (model.added.length && model.torque) {
      const packed = model.torque[which];
      blue = packed.shape ? rows(packed)[joint] : packed[joint];
    }
    const model_ = blue ? drawn(blue) : time.map(() => null);
    const band = (sign) => time.map((_, k) => torque[k] + sign * 1.96 * std[k]);
    this.torque.draw([time, band(1), band(-1), drawn(torque), model_], stretch);
    const inside = time.map((t) => stretch !== null && t >= stretch[0] && t <= stretch[1]);
    for (const [what, chart] of this.against) chart.draw(own[what][joint], torque, blue, inside);
  }

  drawControls() {
    const { recording, joint, stretch } = this.state.values;
    const tab = (words, chosen, click) =>
      element(
        "button",
        { type: "button", class: "tab", "aria-pressed": String(chosen), click },
        words,
      );
    const names = this.data.recordings.map((r) =>
      r.role === "check" ? `${r.name} (held out)` : r.name,
    );
    const again = (place, ...tabs) => {
      const focused = [...place.children].indexOf(document.activeElement);
      fill(place, ...tabs);
      if (focused >= 0) place.children[focused]?.focus();
    };
    again(
      this.tabs,
      ...(names.length < 2
        ? []
        : names.map((name, i) =>
            tab(name, i === recording, () => this.state.set({ recording: i, stretch: null })),
          )),
    );
    again(
      this.jointTabs,
      ...(this.data.joints.length < 2
        ? []
        : this.data.joints.map((name, j) =>
            tab(name, j === joint, () => this.state.set({ joint: j })),
          )),
    );
    const last = this.time[recording].at(-1);
    const [a, b] = stretch ?? [0, last];
    for (const [slider, t] of [
      [this.from, a],
      [this.to, b],
    ]) {
      if (document.activeElement !== slider || !stretch) slider.value = String((1000 * t) / last);
      slider.setAttribute("aria-valuetext", `${t.toFixed(2)} s`);
    }
    this.whole.disabled = stretch === null;
  }

  // -- actions -------------------------------------------------------------------------------

  get line() {
    const { chosen } = this.state.values;
    return command(this.data.name, [...this.data.with, ...chosen]);
  }

  async copy() {
    try {
      await navigator.clipboard.writeText(this.line);
      this.said.textContent = `Copied: ${this.line}`;
    } catch {
      this.said.textContent = this.line; // a page from a file may not be allowed to copy
    }
  }

  save() {
    const text = toml(this.data.toml, this.line, this.state.get("model").numbers);
    const address = URL.createObjectURL(new Blob([text], { type: "application/toml" }));
    element("a", { href: address, download: "explored.toml" }).click();
    URL.revokeObjectURL(address);
    this.said.textContent = "Saved as explored.toml.";
  }

  async hide() {
    this.state.set({ working: "hiding an effect in a simulated arm" });
    const found = await this.server.post("hide", {});
    if (found.error) return this.state.set({ working: "", error: found.error });
    await open(this.server, found.study, true);
  }

  /** News of the search and of files, now and then. */
  async follow(hidden) {
    let version = 0;
    for (let rounds = 0; !this.gone; rounds++) {
      if (rounds) await new Promise((resolve) => setTimeout(resolve, 1000));
      if (this.gone || (rounds && document.hidden)) continue;
      let state;
      try {
        state = await this.server.get("state");
      } catch {
        this.banner.textContent = "The server has stopped; what is here can still be looked at.";
        continue;
      }
      if (this.gone) return;
      if (state.version !== version) {
        const news = await this.server.get(`searched?since=${this.fetched}`);
        if (this.gone) return;
        version = state.version;
        this.keep(news.fits);
        const { chosen, held, model } = this.state.values;
        const better = this.fits.get(keyOf(chosen));
        if (better && model.how !== "refitted" && !held.size) this.state.set({ model: better });
        this.fetched = news.known;
        this.evidence.keep(news);
        this.drawModel();
        this.drawChips();
        this.state.set({ found: news.verdict });
      }
      this.stopped = !state.words;
      this.news(state, hidden);
    }
  }

  news(state, hidden) {
    const button = (words, click) =>
      element("button", { type: "button", class: "action", click }, words);
    const reload = async (add) => {
      const found = await this.server.post("reload", { add });
      if (found.error) return this.state.set({ error: found.error });
      await open(this.server, found.study, false);
    };
    const key = JSON.stringify([state.words, state.changed, state.new, state.error, hidden]);
    if (key === this.told) return;
    this.told = key;
    const parts = [];
    if (state.words)
      parts.push(
        element(
          "span",
          { class: "searching" },
          `Searching for what is missing: ${state.words} ...`,
        ),
      );
    if (state.error) parts.push(element("span", {}, state.error));
    if (state.changed.length) {
      parts.push(
        element(
          "span",
          {},
          `${state.changed.join(", ")} changed on disk. `,
          button("Read again", () => reload([])),
        ),
      );
    }
    for (const name of state.new.slice(0, 3)) {
      parts.push(
        element(
          "span",
          {},
          `New in the folder: ${name}. `,
          button("Add this recording", () => reload([name])),
        ),
      );
    }
    if (hidden) {
      const told = element("span", {});
      parts.push(
        element("span", {}, "An effect is hidden in this simulated arm: which one? "),
        button("Tell me", async () => {
          const { hidden: label } = await this.server.post("reveal", {});
          const right = this.state.get("chosen").includes(label);
          told.textContent = ` It was ${this.name(label)}.${right ? " You have it." : ""}`;
        }),
        button("Back to the recordings", () => open(this.server, this.server.home ?? 0, false)),
        told,
      );
    }
    fill(this.banner, ...parts);
  }
}

let page = null;

/** Show a study of the server. */
async function open(server, study, hidden) {
  if (!hidden) server.home = study;
  page?.destroy();
  server.study = study;
  const words = element("p", { class: "status working" }, "loading");
  fill(
    root,
    element(
      "header",
      {},
      element("p", { class: "kind" }, "residyn explore"),
      element(
        "p",
        { class: "verdict" },
        "Smoothing the recorded motion, and looking at all effects.",
      ),
      words,
    ),
  );
  try {
    const data = await server.payload((said) => (words.textContent = `${said} ...`));
    page = new Page(data, server);
    page.follow(hidden);
  } catch (error) {
    words.className = "status error";
    words.textContent = error.message;
  }
}

const inside = document.getElementById("residyn-explorer-data");
if (inside) page = new Page(await opened(JSON.parse(inside.textContent)), null);
else open(new Server(), 0, false);
