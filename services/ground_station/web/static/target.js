// A landing: beside and over the platform, drawn to scale, with the cone of the descent and the estimate's 3 sigma.
const HEIGHTS = [0.5, 1, 2, 4, 8, 16, 32, 64, 128], WIDTHS = [0.7, 1.4, 3, 6, 12, 25, 50, 100], BARS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50];
const MARKS = { used: "✓", silent: "!", off: "–" };
const WORDS = { used: "in use", silent: "wanted, but nothing comes", off: "not in use" };

export default {
  template: `<section class="target" v-if="landing" :class="{ late: landing.late }" data-mark="target">
    <h2>{{ landing.phase }}</h2>
    <div class="target-views">
      <svg viewBox="0 0 160 178" role="img" aria-label="from the side">
        <text x="4" y="12">from the side</text>
        <path v-if="cone" :d="cone" class="cone" />
        <path d="M0 150H160" class="floor" />
        <rect v-if="landing.platform" :x="80 - 0.5 * side * across" y="150" :width="side * across" height="7" class="platform" />
        <g v-if="pos"><ellipse v-if="spread" :cx="beside" :cy="up" :rx="spread.aside" :ry="spread.up" class="spread" />
          <path :d="'M' + (beside - 9) + ' ' + up + 'h18M' + beside + ' ' + (up - 7) + 'v14'" class="vehicle" /></g>
        <path :d="'M6 172h' + sideBar * across" class="bar" /><text x="6" y="168" class="small">{{ sideBar }} m</text>
        <path d="M150 32h6v118h-6M152 91h4" class="bar" /><text x="147" y="36" class="small end">{{ top }} m</text>
        <text x="147" y="95" class="small end">{{ top / 2 }}</text>
      </svg>
      <svg viewBox="-80 -85 160 178" role="img" aria-label="from above">
        <text x="-76" y="-73">from above</text>
        <g :transform="'rotate(' + ((landing.yaw ?? 0) * 180) / Math.PI + ')'" v-if="landing.platform">
          <rect :x="-0.5 * side * over" :y="-0.5 * side * over" :width="side * over" :height="side * over" class="platform" />
          <rect :x="-0.3 * side * over" :y="-0.3 * side * over" :width="0.6 * side * over" :height="0.6 * side * over" class="tag" />
          <path :d="'M0 ' + -0.5 * side * over + 'l5 8h-10z'" class="nose" /></g>
        <path v-else d="M-8 -8L8 8M8 -8L-8 8" class="spot" />
        <circle v-if="landing.cone" :r="landing.cone * over" class="cone" />
        <g v-if="pos" :transform="'translate(' + pos[1] * over + ' ' + -pos[0] * over + ')'">
          <polygon v-if="outline" :points="outline" class="spread" /><path d="M-9 0H9M0 -9V9" class="vehicle" /></g>
        <path d="M68 -58V-76l-4 6l4 -6l4 6" class="bar" /><text x="68" y="-47" class="small middle">N</text>
        <path :d="'M-74 87h' + aboveBar * over" class="bar" /><text x="-74" y="83" class="small">{{ aboveBar }} m</text>
      </svg>
    </div>
    <div class="target-rows"><div v-for="row in landing.rows" :key="row.label" class="reading" :class="{ late: row.late }">
      <span class="reading-label">{{ row.label }}</span><span class="reading-value">{{ row.text }}<small v-if="row.unit">{{ row.unit }}</small></span></div></div>
    <div class="target-inputs"><span v-for="input in landing.inputs" :key="input.name" :class="input.state" :title="words[input.state]">
      <b>{{ marks[input.state] }}</b> {{ input.name }}</span></div>
    <p :class="landing.verdict.tone">{{ landing.verdict.tone === "good" ? "✓ " : landing.verdict.tone === "bad" ? "✕ " : "" }}{{ landing.verdict.text }}</p>
  </section>`,
  props: { landing: Object, side: Number },
  data() {
    return { marks: MARKS, words: WORDS };
  },
  computed: {
    pos() {
      return this.landing.pos;
    },
    height() {
      return this.pos ? -this.pos[2] : 0;
    },
    aside() {
      return this.pos ? Math.hypot(this.pos[0], this.pos[1]) : 0;
    },
    // -- from the side: the horizontal distance to the right, both in one scale as far as it can be seen --
    top() {
      return fit(HEIGHTS, 1.1 * this.height);
    },
    wide() {
      return fit(WIDTHS, Math.max(1.1 * this.aside, 0.55 * this.side));
    },
    across() {
      return 76 / this.wide;
    },
    sideBar() {
      return BARS.findLast((bar) => bar <= 0.5 * this.wide);
    },
    beside() {
      return 80 + this.aside * this.across;
    },
    up() {
      return 150 - (this.height / this.top) * 118;
    },
    cone() {
      const { cone } = this.landing;
      if (!cone || this.height < 0.05) return "";
      const half = ((cone * this.top) / this.height) * this.across;
      return `M80 150L${80 - half} 32H${80 + half}Z`;
    },
    spread() {
      const { axes } = this.landing;
      if (!axes) return null;
      const direction = this.aside > 1e-6 ? [this.pos[0] / this.aside, this.pos[1] / this.aside, 0] : [1, 0, 0];
      return { aside: extent(axes, direction) * this.across, up: (extent(axes, [0, 0, 1]) / this.top) * 118 };
    },
    // -- from above: north is up --
    plane() {
      return fit(WIDTHS, Math.max(1.1 * this.aside, 0.6 * this.side));
    },
    over() {
      return 76 / this.plane;
    },
    aboveBar() {
      return BARS.findLast((bar) => bar <= 0.5 * this.plane);
    },
    // The ellipse that an ellipsoid is from above.
    outline() {
      const { axes } = this.landing;
      if (!axes) return "";
      const [nn, ne, ee] = [[0, 0], [0, 1], [1, 1]].map(([i, j]) => axes.reduce((sum, axis) => sum + axis[i] * axis[j], 0));
      const l11 = Math.sqrt(Math.max(nn, 1e-9)), l21 = ne / l11, l22 = Math.sqrt(Math.max(ee - l21 * l21, 0));
      return Array.from({ length: 36 }, (_, i) => {
        const [c, s] = [Math.cos((i * Math.PI) / 18), Math.sin((i * Math.PI) / 18)];
        return `${(l21 * c + l22 * s) * this.over},${-l11 * c * this.over}`;
      }).join(" ");
    },
  },
};

function fit(sizes, needed) {
  return sizes.find((size) => size >= needed) ?? sizes.at(-1);
}

// Half the width of an ellipsoid along a direction.
function extent(axes, direction) {
  return Math.sqrt(axes.reduce((sum, axis) => sum + axis.reduce((dot, part, i) => dot + part * direction[i], 0) ** 2, 0));
}
