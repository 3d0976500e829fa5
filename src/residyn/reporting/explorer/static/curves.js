// Measured, model and what is left of each joint, against time; all charts zoom together.

import { drawn, rows } from "./arrays.js";
import { TimeChart } from "./charts.js";
import { element } from "./elements.js";
import { inUnit, position } from "./words.js";

export class Curves {
  constructor(data, { onStretch, colours }) {
    this.data = data;
    this.time = data.recordings.map((r) => r.time.values);
    this.angle = data.recordings.map((r) => rows(r.angle));
    this.place = element("div", { class: "curves" });
    const shared = { sync: "time", zoomed: true, onStretch, colours };
    this.pairs = data.joints.map((joint, j) => {
      const unit = data.reading_units[j];
      const spots = [element("div", { class: "chart" }), element("div", { class: "chart" })];
      this.place.append(element("div", {}, element("h3", {}, joint), ...spots));
      const angle = new TimeChart(spots[0], {
        ...shared,
        height: 190,
        label: inUnit(data.reads[j] === "angle" ? position([unit]) : data.reads[j], unit),
        series: [
          { colour: "measured", width: 4 },
          { colour: "model", width: 1.5 },
        ],
      });
      const left = new TimeChart(spots[1], {
        ...shared,
        height: 130,
        label: inUnit("left", unit),
        series: [{ width: 0, band: true }, { width: 0 }, { colour: "residual", width: 1.2 }],
      });
      return [angle, left];
    });
    this.charts = this.pairs.flat();
  }

  /** How long a recording is, s. */
  last(recording) {
    return this.time[recording].at(-1);
  }

  /** What a model predicts for each joint of a recording, or null. */
  predicted(model, recording) {
    if (model.predicted) return model.predicted[recording];
    return model.curves[recording] ? rows(model.curves[recording]) : null;
  }

  draw(model, recording, stretch) {
    const predicted = this.predicted(model, recording);
    const x = Array.from(this.time[recording]);
    this.pairs.forEach(([angle, left], j) => {
      const measured = this.angle[recording][j];
      const own = predicted ? predicted[j] : measured.map(() => NaN);
      const noise = 2 * this.data.recordings[recording].noise[j];
      angle.draw([x, drawn(measured), drawn(own)], stretch);
      const residual = drawn(measured.map((y, k) => y - own[k]));
      left.draw([x, x.map(() => noise), x.map(() => -noise), residual], stretch);
    });
  }
}
