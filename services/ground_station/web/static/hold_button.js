// A button that acts only when it is held for a second.
const HOLD_MS = 1000;

export default {
  template: `<button type="button" class="hold" :class="{ holding }" @pointerdown="down" @pointerup="up" @pointerleave="up"
    @pointercancel="up" @contextmenu.prevent><span>{{ text }}</span></button>`,
  props: { text: String },
  data() {
    return { holding: false };
  },
  unmounted() {
    clearTimeout(this.timer);
  },
  methods: {
    down() {
      this.holding = true;
      this.timer = setTimeout(() => {
        this.up();
        this.$emit("held");
      }, HOLD_MS);
    },
    up() {
      this.holding = false;
      clearTimeout(this.timer);
    },
  },
};
