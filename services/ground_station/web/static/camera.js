// The camera's picture. The next one is requested when the last one has arrived, so a slow link gets fewer.
export default {
  template: `<div class="camera"><img ref="picture" alt="picture of the camera" :hidden="!!note" /><div v-if="note" class="camera-note">{{ note }}</div><div v-else-if="preview" class="camera-preview">preview</div></div>`,
  props: { address: String, period_ms: Number },
  data() {
    return { note: "waiting for a picture", preview: false };
  },
  mounted() {
    this.next();
  },
  unmounted() {
    clearTimeout(this.timer);
    this.gone = true;
    if (this.url) URL.revokeObjectURL(this.url);
  },
  methods: {
    async next() {
      const start = performance.now();
      if (this.$el.clientWidth && !document.hidden) await this.fetch();
      if (!this.gone) this.timer = setTimeout(() => this.next(), Math.max(50, this.period_ms - performance.now() + start));
    },
    async fetch() {
      try {
        const reply = await fetch(this.address, { cache: "no-store" });
        if (reply.status === 204) {
          this.note = "no picture of the camera";
          return;
        }
        this.preview = reply.headers.get("x-picture") === "preview";
        const url = URL.createObjectURL(await reply.blob());
        if (this.url) URL.revokeObjectURL(this.url);
        this.$refs.picture.src = this.url = url;
        this.note = "";
      } catch (error) {
        this.note = "the ground station does not reply";
      }
    },
  },
};
