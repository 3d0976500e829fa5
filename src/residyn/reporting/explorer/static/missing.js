// The torque that springs and dampers lack, against time, rate, angle and amplitude.

import { drawn, rows } from "./arrays.js";
import { CloudChart, TimeChart } from "./charts.js";
import { element } from "./elements.js";
import { force, inUnit, position } from "./words.js";

const SIGMAS = 1.96;
const LOUD = 100; // squared standard deviations from which on an instant says no more

export class Missing {
  /** `joint()`: which joint is shown. */
  constructor(data, { joint, onStretch, colours }) {
    this.recordings = data.missing.map((m) => ({
      time: m.time.values,
      ...Object.fromEntries(
        ["angle", "rate", "amplitude", "torque", "std"].map((k) => [k, rows(m[k])]),
      ),
    }));
    this.names = data.recordings.length > 1 ? data.missing.map((m) => m.recording) : [];
    this.whose = element("p", { class: "note wide" });
    this.place = element("div", { class: "clouds" }, this.whose);
    const unit = () => data.units[joint()];
    const of =
      (words, after = "") =>
      () =>
        inUnit(words, unit(), after);
    const torque = () => {
      const own = data.missing[0].units[joint()];
      return inUnit(force([own]), own);
    };
    this.spoken = (what) => (what === "angle" ? position([unit()]) : what);
    this.titles = new Map();
    const spot = (what, wide) => {
      const place = element("div", { class: "chart" });
      this.titles.set(what, element("h3", {}, ""));
      this.place.append(
        element("div", { class: wide ? "wide" : null }, this.titles.get(what), place),
      );
      return place;
    };
    this.overTime = new TimeChart(spot("time", true), {
      height: 200,
      label: torque,
      zoomed: false,
      sync: "time",
      onStretch,
      colours,
      series: [
        { width: 0, band: true },
        { width: 0 },
        { colour: "measured", width: 1.2 },
        { colour: "model", width: 1.5 },
      ],
    });
    const angle = () => inUnit(this.spoken("angle"), unit());
    const labels = { rate: of("rate", "/s"), angle, amplitude: of("amplitude") };
    this.against = Object.entries(labels).map(([what, label]) => [
      what,
      new CloudChart(spot(what), { height: 220, labels: [label, torque], colours }),
    ]);
    this.charts = [this.overTime, ...this.against.map(([, chart]) => chart)];
  }

  /** The joint that lacks most, in its own bands. */
  loudest() {
    const { torque, std } = this.recordings[0];
    const share = torque.map((row, j) =>
      row.reduce((sum, x, k) => sum + Math.min(LOUD, (x / std[j][k]) ** 2), 0),
    );
    return share.indexOf(Math.max(...share));
  }

  draw(model, recording, joint, stretch) {
    const which = Math.min(recording, this.recordings.length - 1);
    const own = this.recordings[which];
    const chosen = which === recording ? stretch : null; // of a held-out one the torque is not known
    this.whose.textContent = this.names.length ? `In ${this.names[which]}.` : "";
    for (const [what, title] of this.titles) title.textContent = `against ${this.spoken(what)}`;
    const [torque, std] = [own.torque[joint], own.std[joint]];
    const time = Array.from(own.time);
    let made = null;
    if (model.added.length && model.torque) {
      const packed = model.torque[which];
      made = packed.shape ? rows(packed)[joint] : packed[joint];
    }
    const band = (sign) => time.map((_, k) => torque[k] + sign * SIGMAS * std[k]);
    const curve = made ? drawn(made) : time.map(() => null);
    this.overTime.draw([time, band(1), band(-1), drawn(torque), curve], chosen);
    const inside = time.map((t) => chosen !== null && t >= chosen[0] && t <= chosen[1]);
    for (const [what, chart] of this.against) chart.draw(own[what][joint], torque, made, inside);
  }
}
