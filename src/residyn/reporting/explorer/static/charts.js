// Charts: curves against time, and clouds of points, drawn by uPlot; all follow one stretch of time.

/** The colours of the page's style, for canvases. */
export function colours(root) {
  const style = getComputedStyle(root);
  const names = ["ink", "soft", "line", "measured", "model", "residual", "band", "mark"];
  return Object.fromEntries(names.map((n) => [n, style.getPropertyValue(`--${n}`).trim()]));
}

const ROOM = 0.04; // beside a cloud of points, of its width
const FONT = "12px system-ui, sans-serif";

function axis(label, c, side) {
  return {
    label,
    side,
    stroke: () => c().soft,
    font: FONT,
    labelFont: FONT,
    labelSize: 18,
    size: side === 2 ? 30 : 58,
    // Of a low chart as well, more than one tick has room.
    space: side === 2 ? 50 : (_u, _axis, _least, _most, size) => Math.min(22, size / 4),
    grid: { stroke: () => c().line, width: 1 },
    ticks: { stroke: () => c().line, width: 1, size: 4 },
    values:
      side === 2 ? undefined : (_, ticks) => ticks.map((x) => String(Number(x.toPrecision(6)))),
  };
}

class Chart {
  constructor(place, height, c) {
    this.place = place;
    this.height = height;
    this.colours = c;
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(place);
  }

  start(options, data) {
    this.plot = new uPlot(
      {
        width: Math.max(200, this.place.clientWidth),
        height: this.height,
        legend: { show: false },
        padding: [8, 20, 0, 0], // half of the last number of the axis is beside the chart
        ...options,
      },
      data,
      this.place,
    );
  }

  resize() {
    const width = this.place.clientWidth;
    if (this.plot && width > 0 && width !== this.plot.width) {
      this.plot.setSize({ width, height: this.height });
    }
  }

  redraw() {
    this.plot?.redraw(false, true);
  }

  destroy() {
    this.observer.disconnect();
    this.plot?.destroy();
  }
}

/** Curves against time. A drag chooses a stretch of time. */
export class TimeChart extends Chart {
  /**
   * `series`: [{ colour, width, band: [low, high] | undefined }], as names of colours; `zoomed`:
   * whether the chart zooms to the stretch instead of marking it.
   */
  constructor(place, { height, label, series, zoomed, sync, onStretch, colours: c }) {
    super(place, height, c);
    this.zoomed = zoomed;
    this.stretch = null;
    this.start(
      {
        scales: { x: { time: false } },
        cursor: {
          sync: sync ? { key: sync } : undefined,
          drag: { x: true, y: false, setScale: false },
          points: { show: false },
          y: false,
        },
        axes: [axis("time, s", c, 2), axis(label, c, 3)],
        series: [
          {},
          ...series.map((s) => ({
            stroke: s.colour ? () => c()[s.colour] : undefined,
            width: s.width,
            points: { show: false },
            spanGaps: false,
          })),
        ],
        bands: series.flatMap((s, i) =>
          s.band ? [{ series: [i + 1, i + 2], fill: () => c().band }] : [],
        ),
        hooks: {
          setSelect: [
            (u) => {
              const { left, width } = u.select;
              if (width < 4) return;
              const [a, b] = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
              u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
              onStretch([a, b]);
            },
          ],
          drawClear: [(u) => this.mark(u)],
        },
      },
      [[0, 1], ...series.map(() => [null, null])],
    );
  }

  mark(u) {
    if (this.zoomed || !this.stretch) return;
    const [a, b] = this.stretch.map((t) => u.valToPos(t, "x", true));
    u.ctx.save();
    u.ctx.globalAlpha = 0.22;
    u.ctx.fillStyle = this.colours().mark;
    u.ctx.fillRect(a, u.bbox.top, b - a, u.bbox.height);
    u.ctx.restore();
  }

  draw(data, stretch) {
    this.stretch = stretch;
    this.plot.setData(data, false);
    const time = data[0];
    const [min, max] = this.zoomed && stretch ? stretch : [time[0], time.at(-1)];
    this.plot.setScale("x", { min, max });
  }
}

/** Points of something against something else, with the curve of a model through them. */
export class CloudChart extends Chart {
  constructor(place, { height, labels, colours: c }) {
    super(place, height, c);
    this.marked = [];
    const silent = { paths: () => null, points: { show: false } };
    const roomy = (_, least, most) => {
      const room = ROOM * (most - least || 1);
      return [least - room, most + room];
    };
    this.start(
      {
        scales: { x: { time: false, range: roomy } },
        cursor: { show: false },
        axes: [axis(labels[0], c, 2), axis(labels[1], c, 3)],
        series: [{}, silent, silent],
        hooks: { draw: [(u) => this.points(u)] },
      },
      [
        [0, 1],
        [null, null],
        [null, null],
      ],
    );
  }

  points(u) {
    const [x, measured, model] = u.data;
    const c = this.colours();
    const size = devicePixelRatio;
    u.ctx.save();
    u.ctx.beginPath();
    u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    u.ctx.clip();
    const dots = (values, colour, radius, chosen) => {
      u.ctx.fillStyle = colour;
      for (let k = 0; k < x.length; k++) {
        if (values[k] === null || (chosen && !this.marked[k])) continue;
        const [a, b] = [u.valToPos(x[k], "x", true), u.valToPos(values[k], "y", true)];
        u.ctx.fillRect(a - radius * size, b - radius * size, 2 * radius * size, 2 * radius * size);
      }
    };
    dots(measured, c.measured, 1.4, false);
    dots(measured, c.mark, 1.8, true);
    dots(model, c.model, 1.1, false);
    u.ctx.restore();
  }

  /** `x`, `measured`, `model` (or null) and `marked`, in any order of x. */
  draw(x, measured, model, marked) {
    const order = Array.from(x, (_, k) => k).sort((a, b) => x[a] - x[b]);
    const sorted = (values) => order.map((k) => (Number.isFinite(values[k]) ? values[k] : null));
    this.marked = order.map((k) => marked[k]);
    this.plot.setData([sorted(x), sorted(measured), model ? sorted(model) : order.map(() => null)]);
  }
}
