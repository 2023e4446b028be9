// The time line of a recording. While it is dragged, it shows the place of the hand and not that of the server.
const SPEEDS = [0.25, 0.5, 1, 2, 5, 10, 20];
const SEEK_GAP_MS = 120;

export default {
  template: `<div class="timeline">
    <button class="timeline-play" data-mark="play" :aria-label="playing ? 'Pause' : 'Play'" @click="$emit('play', !playing)">{{ playing ? "❚❚" : "▶" }}</button>
    <span class="timeline-time" data-mark="time">{{ words(shown) }} / {{ words(duration) }}</span>
    <div class="timeline-line">
      <button v-for="(mark, i) in marks" :key="i" class="timeline-mark" :class="mark.tone" :style="{ left: place(mark.t) }"
        :title="words(mark.t) + '\\n' + mark.texts.join('\\n')" :aria-label="mark.texts.join('. ')" tabindex="-1" @click="$emit('seek', mark.t)"></button>
      <input type="range" min="0" :max="duration" step="0.01" :value="shown" data-mark="slider" aria-label="Time"
        @input="drag($event.target.valueAsNumber)" @change="drop($event.target.valueAsNumber)" @keydown.space.prevent />
    </div>
    <span class="timeline-next">{{ last }}</span>
    <select data-mark="speed" aria-label="Speed" :value="now?.speed ?? 1" @change="$emit('speed', Number($event.target.value))">
      <option v-for="speed in speeds" :key="speed" :value="speed">{{ speed }} ×</option>
    </select></div>`,
  props: { duration: Number, marks: Array, now: Object },
  data() {
    return { hand: null, speeds: SPEEDS };
  },
  created() {
    this.sent = 0;
  },
  computed: {
    playing() {
      return !!this.now?.playing;
    },
    shown() {
      return this.hand ?? this.now?.t ?? 0;
    },
    last() {
      return this.marks.findLast((mark) => mark.t <= this.shown + 0.005)?.texts.join(" · ") ?? "";
    },
  },
  methods: {
    words(t) {
      const minutes = Math.floor(t / 60);
      return `${minutes}:${(t - 60 * minutes).toFixed(1).padStart(4, "0")}`;
    },
    place(t) {
      return `${(100 * t) / Math.max(this.duration, 0.01)}%`;
    },
    drag(t) {
      this.hand = t;
      if (performance.now() - this.sent < SEEK_GAP_MS) return;
      this.sent = performance.now();
      this.$emit("seek", t);
    },
    drop(t) {
      this.$emit("seek", t);
      this.hand = t;
      clearTimeout(this.timer);
      this.timer = setTimeout(() => (this.hand = null), 400);
    },
  },
};
