// Lines over the last minute, one chart for each unit. The server sends only new values, with their ages.
const COLORS = ["#4aa8ff", "#ffc247", "#3ddc84", "#ff6b5e", "#c79bff", "#4dd2ff"];
const HEIGHT = 150, LEFT = 46, BOTTOM = 18, TOP = 8, RIGHT = 6;

export default {
  template: `<div class="plots"><div v-for="chart in charts" :key="chart.unit" class="plot">
    <div v-for="line in chart.lines" :key="line.id" class="plot-line"><i :style="{ background: color(line) }"></i>
      <span>{{ line.label }}</span><strong>{{ values[line.id] }} {{ line.unit }}</strong>
      <button @click="$emit('remove', line.id)" :aria-label="'Remove ' + line.label">×</button></div>
    <canvas :ref="(canvas) => (canvases[chart.unit] = canvas)"></canvas></div></div>`,
  props: { lines: Array, span: Number },
  data() {
    return { values: {} };
  },
  created() {
    this.points = new Map();
    this.canvases = {};
  },
  computed: {
    charts() {
      const units = [...new Set((this.lines ?? []).map((line) => line.unit))];
      return units.map((unit) => ({ unit, lines: this.lines.filter((line) => line.unit === unit) }));
    },
  },
  methods: {
    color(line) {
      return COLORS[line.id % COLORS.length];
    },
    add(added) {
      const now = performance.now() / 1000;
      for (const [id, values] of Object.entries(added)) {
        const points = this.points.get(Number(id)) ?? [];
        for (const [age, value] of values) points.push([now + age, value]);
        this.points.set(Number(id), points);
        this.values[id] = this.words(values.at(-1)[1]);
      }
      const kept = new Set((this.lines ?? []).map((line) => line.id));
      for (const [id, points] of this.points) {
        if (!kept.has(id)) this.points.delete(id);
        else points.splice(0, Math.max(0, points.findIndex((point) => point[0] > now - this.span)));
      }
      for (const chart of this.charts) this.draw(chart, now);
    },
    words(value) {
      const size = Math.abs(value);
      return value === 0 ? "0" : size >= 1e5 || size < 1e-3 ? value.toExponential(2) : value.toPrecision(4);
    },
    // A round step that divides a range into about four parts.
    step(range) {
      const power = 10 ** Math.floor(Math.log10(range / 4));
      return power * ([1, 2, 5].find((factor) => factor * power >= range / 4) ?? 10);
    },
    draw(chart, now) {
      const canvas = this.canvases[chart.unit], width = canvas?.clientWidth;
      if (!width) return;
      const ratio = window.devicePixelRatio;
      canvas.width = width * ratio;
      canvas.height = HEIGHT * ratio;
      const pen = canvas.getContext("2d");
      pen.scale(ratio, ratio);
      const all = chart.lines.flatMap((line) => this.points.get(line.id) ?? []);
      let low = Math.min(...all.map((point) => point[1])), high = Math.max(...all.map((point) => point[1]));
      if (!all.length) [low, high] = [-1, 1];
      const margin = 0.08 * (high - low) || Math.max(0.05 * Math.abs(high), 1e-3);
      low -= margin;
      high += margin;
      const x = (t) => width - RIGHT - ((now - t) / this.span) * (width - LEFT - RIGHT);
      const y = (value) => HEIGHT - BOTTOM - ((value - low) / (high - low)) * (HEIGHT - BOTTOM - TOP);
      this.grid(pen, width, low, high, y);
      for (const line of chart.lines) this.line(pen, line, x, y);
    },
    grid(pen, width, low, high, y) {
      pen.font = "11px system-ui";
      pen.fillStyle = "#a9b4c0";
      pen.strokeStyle = "#2b3440";
      pen.textAlign = "right";
      const step = this.step(high - low);
      const decimals = Math.max(0, Math.min(6, -Math.floor(Math.log10(step))));
      for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
        pen.strokeRect(LEFT, y(value), width - LEFT - RIGHT, 0);
        pen.fillText(value.toFixed(decimals), LEFT - 5, y(value) + 4);
      }
      pen.textAlign = "center";
      for (let age = 0; age <= this.span; age += 15) {
        const place = width - RIGHT - (age / this.span) * (width - LEFT - RIGHT);
        pen.fillText(age ? `−${age} s` : "now", Math.min(place, width - 16), HEIGHT - 4);
      }
    },
    line(pen, line, x, y) {
      pen.strokeStyle = this.color(line);
      pen.lineWidth = 1.6;
      pen.beginPath();
      let last = -Infinity; // a gap of a second is no line
      for (const [t, value] of this.points.get(line.id) ?? []) {
        t - last > 1 ? pen.moveTo(x(t), y(value)) : pen.lineTo(x(t), y(value));
        last = t;
      }
      pen.stroke();
      pen.lineWidth = 1;
    },
  },
};
