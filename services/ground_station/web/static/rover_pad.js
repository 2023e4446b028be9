// A pad that drives the rover while it is held: up is forward, to the side turns. It repeats itself while it is held, so
// that the rover stops when the page goes away too.
const PERIOD_MS = 150;

export default {
  template: `<div class="rover-pad" ref="pad" data-mark="rover-pad" :class="{ held }" @pointerdown.prevent="down" @pointermove="move"
    @pointerup="stop" @pointercancel="stop" @lostpointercapture="stop" @contextmenu.prevent>
    <span class="rover-axis up">▲</span><span class="rover-axis down">▼</span>
    <span class="rover-axis left">↺</span><span class="rover-axis right">↻</span>
    <i :style="{ left: 50 + 38 * turn + '%', top: 50 - 38 * speed + '%' }"></i></div>`,
  data() {
    return { held: false, speed: 0, turn: 0 };
  },
  mounted() {
    this.hide = () => document.hidden && this.stop();
    document.addEventListener("visibilitychange", this.hide);
    window.addEventListener("blur", this.stop);
    window.addEventListener("pagehide", this.stop);
  },
  unmounted() {
    document.removeEventListener("visibilitychange", this.hide);
    window.removeEventListener("blur", this.stop);
    window.removeEventListener("pagehide", this.stop);
    this.stop();
  },
  methods: {
    down(event) {
      this.$refs.pad.setPointerCapture(event.pointerId);
      this.held = true;
      this.move(event);
      this.send();
      this.timer = setInterval(this.send, PERIOD_MS);
    },
    move(event) {
      if (!this.held) return;
      const box = this.$refs.pad.getBoundingClientRect();
      this.turn = part((event.clientX - box.left) / box.width);
      this.speed = -part((event.clientY - box.top) / box.height);
    },
    send() {
      this.$emit("drive", [this.speed, this.turn]);
    },
    stop() {
      clearInterval(this.timer);
      if (this.held) this.$emit("release");
      Object.assign(this, { held: false, speed: 0, turn: 0 });
    },
  },
};

// From -1 to 1 across the pad, in tenths, with a dead zone in the middle.
function part(fraction) {
  const value = Math.max(-1, Math.min(1, (2 * fraction - 1) / 0.76));
  return Math.abs(value) < 0.12 ? 0 : Math.round(10 * value) / 10;
}
