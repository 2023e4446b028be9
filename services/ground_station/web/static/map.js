// The map: north is up, metres of the world frame. Points are clicked, areas are drawn, a plan is shown.

const MIN_SCALE = 1, MAX_SCALE = 300; // pixels a metre
const GRIDS = [0.5, 1, 2, 5, 10, 20, 50, 100];

export default {
  template: `<div class="map">
    <canvas ref="canvas" @pointerdown="down" @pointermove="move" @pointerup="up" @pointercancel="drag = null"
      @wheel.prevent="wheel" @contextmenu.prevent></canvas>
    <div class="map-place">{{ place }}</div>
  </div>`,
  props: { robot: Object },
  data() {
    return { place: "" };
  },
  mounted() {
    Object.assign(this, { center: [0, 0], scale: 40, mode: "look", trail: [], plan: null, area: [], point: null, state: null, drag: null });
    this.sizes = new ResizeObserver(() => this.draw());
    this.sizes.observe(this.$el);
  },
  unmounted() {
    this.sizes.disconnect();
  },
  methods: {
    update(state) {
      this.state = state;
      this.draw();
    },
    setTrail(points) {
      this.trail = points;
    },
    setPlan(plan) {
      this.plan = plan;
      this.draw();
    },
    setMode(mode) {
      this.mode = mode;
      this.$refs.canvas.style.cursor = mode === "look" ? "grab" : "crosshair";
    },
    setArea(points) {
      this.area = points;
      this.draw();
    },
    setPoint(point) {
      this.point = point;
      this.draw();
    },
    // -- places and pixels --
    toPixel([north, east]) {
      const { clientWidth: w, clientHeight: h } = this.$el;
      return [w / 2 + (east - this.center[1]) * this.scale, h / 2 - (north - this.center[0]) * this.scale];
    },
    toPlace(event) {
      const box = this.$el.getBoundingClientRect();
      const x = event.clientX - box.left - box.width / 2, y = event.clientY - box.top - box.height / 2;
      return [this.center[0] - y / this.scale, this.center[1] + x / this.scale].map((part) => Math.round(100 * part) / 100);
    },
    near(place) {
      const [x, y] = this.toPixel(place);
      return this.area.findIndex((corner) => {
        const [cx, cy] = this.toPixel(corner);
        return Math.hypot(cx - x, cy - y) < 12;
      });
    },
    // -- pointer --
    down(event) {
      this.$refs.canvas.setPointerCapture(event.pointerId);
      const place = this.toPlace(event), corner = this.mode === "area" ? this.near(place) : -1;
      this.drag = { x: event.clientX, y: event.clientY, center: [...this.center], moved: false, corner };
    },
    move(event) {
      const place = this.toPlace(event);
      this.place = `${place[0].toFixed(1)} m north, ${place[1].toFixed(1)} m east`;
      if (!this.drag) return;
      const dx = event.clientX - this.drag.x, dy = event.clientY - this.drag.y;
      if (Math.hypot(dx, dy) > 4) this.drag.moved = true;
      if (!this.drag.moved) return;
      if (this.drag.corner >= 0) this.area[this.drag.corner] = place;
      else this.center = [this.drag.center[0] + dy / this.scale, this.drag.center[1] - dx / this.scale];
      this.draw();
    },
    up(event) {
      const drag = this.drag;
      this.drag = null;
      if (!drag) return;
      if (drag.moved) {
        if (drag.corner >= 0) this.$emit("area", this.area);
        return;
      }
      const place = this.toPlace(event);
      if (this.mode === "point") {
        this.point = place;
        this.$emit("point", place);
      } else if (this.mode === "area") {
        if (event.button === 2 && drag.corner >= 0) this.area.splice(drag.corner, 1);
        else if (drag.corner < 0) this.area.push(place);
        this.$emit("area", this.area);
      }
      this.draw();
    },
    wheel(event) {
      const before = this.toPlace(event);
      this.scale = Math.min(MAX_SCALE, Math.max(MIN_SCALE, this.scale * Math.exp(-event.deltaY / 600)));
      const after = this.toPlace(event);
      this.center = [this.center[0] + before[0] - after[0], this.center[1] + before[1] - after[1]];
      this.draw();
    },
    // -- drawing --
    draw() {
      if (!this.due) this.due = requestAnimationFrame(() => this.drawNow());
    },
    drawNow() {
      this.due = 0;
      const canvas = this.$refs.canvas, { clientWidth: w, clientHeight: h } = this.$el, ratio = window.devicePixelRatio;
      if (!w || !h) return;
      if (canvas.width !== w * ratio || canvas.height !== h * ratio) [canvas.width, canvas.height] = [w * ratio, h * ratio];
      const c = canvas.getContext("2d", { willReadFrequently: true }); // drawn by the processor: few lines, also without a graphics card
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      c.fillStyle = "#5a3524";
      c.fillRect(0, 0, w, h);
      this.drawGrid(c, w, h);
      this.drawLine(c, this.trail, "#2f9bff", 2.5);
      if (this.plan) {
        this.drawLine(c, this.plan.path, "#ffd34d", 2);
        c.fillStyle = "#ffd34d";
        for (const place of this.plan.pictures) {
          const [x, y] = this.toPixel(place);
          c.fillRect(x - 1.5, y - 1.5, 3, 3);
        }
      }
      this.drawArea(c);
      this.drawRover(c);
      this.drawPoint(c);
      this.drawVehicle(c);
    },
    drawGrid(c, w, h) {
      const step = GRIDS.find((grid) => grid * this.scale > 55) ?? 200;
      c.strokeStyle = "rgba(255,255,255,.13)";
      c.fillStyle = "rgba(255,255,255,.75)";
      c.font = "12px system-ui";
      c.lineWidth = 1;
      const [bottom, left] = [this.center[0] - h / 2 / this.scale, this.center[1] - w / 2 / this.scale];
      for (let east = Math.ceil(left / step) * step; (east - left) * this.scale < w; east += step) {
        const x = (east - left) * this.scale;
        stroke(c, [[x, 0], [x, h]]);
      }
      for (let north = Math.ceil(bottom / step) * step; (north - bottom) * this.scale < h; north += step) {
        const y = h - (north - bottom) * this.scale;
        stroke(c, [[0, y], [w, y]]);
      }
      c.strokeStyle = "#fff";
      c.lineWidth = 2;
      stroke(c, [[w - 20 - step * this.scale, h - 18], [w - 20, h - 18]]);
      c.textAlign = "right";
      c.fillText(`${step} m`, w - 20, h - 24);
      c.textAlign = "center";
      c.fillText("N", w - 24, 24);
      stroke(c, [[w - 24, 48], [w - 24, 30], [w - 28, 36], [w - 24, 30], [w - 20, 36]]);
    },
    drawLine(c, places, color, width) {
      if (places.length < 2) return;
      c.strokeStyle = color;
      c.lineWidth = width;
      stroke(c, places.map((place) => this.toPixel(place)));
    },
    drawArea(c) {
      if (!this.area.length) return;
      c.beginPath();
      for (const corner of this.area) c.lineTo(...this.toPixel(corner));
      c.closePath();
      c.fillStyle = "rgba(77,210,255,.16)";
      c.fill();
      c.strokeStyle = "#4dd2ff";
      c.lineWidth = 2;
      c.stroke();
      for (const corner of this.area) {
        c.beginPath();
        c.arc(...this.toPixel(corner), 6, 0, 7);
        c.fillStyle = "#fff";
        c.fill();
        c.stroke();
      }
    },
    drawPoint(c) {
      if (!this.point) return;
      const [x, y] = this.toPixel(this.point);
      c.strokeStyle = "#ffd34d";
      c.lineWidth = 2.5;
      c.beginPath();
      c.arc(x, y, 9, 0, 7);
      c.stroke();
      stroke(c, [[x - 14, y], [x + 14, y]]);
      stroke(c, [[x, y - 14], [x, y + 14]]);
    },
    drawRover(c) {
      const rover = this.state?.rover;
      if (!rover) return;
      const side = Math.max(this.robot.platform.side * this.scale, 14);
      turned(c, this.toPixel(rover.pos), rover.yaw, () => {
        c.globalAlpha = rover.late ? 0.4 : 1;
        c.fillStyle = "#f2f4f6";
        c.strokeStyle = "#20262d";
        c.lineWidth = 2;
        c.fillRect(-side / 2, -side / 2, side, side);
        c.strokeRect(-side / 2, -side / 2, side, side);
        c.fillStyle = "#101010";
        c.fillRect(-0.3 * side, -0.3 * side, 0.6 * side, 0.6 * side);
        c.fillStyle = "#ff8a1f";
        c.fillRect(-side / 6, -side / 2, side / 3, 4);
      });
    },
    drawVehicle(c) {
      const vehicle = this.state?.vehicle;
      if (!vehicle) return;
      turned(c, this.toPixel(vehicle.pos), (vehicle.yaw * Math.PI) / 180, () => {
        c.globalAlpha = vehicle.late ? 0.4 : 1;
        c.beginPath();
        for (const [x, y] of [[0, -16], [11, 12], [0, 6], [-11, 12]]) c.lineTo(x, y);
        c.closePath();
        c.fillStyle = "#2f9bff";
        c.strokeStyle = "#fff";
        c.lineWidth = 2;
        c.fill();
        c.stroke();
      });
    },
  },
};

function stroke(c, pixels) {
  c.beginPath();
  for (const pixel of pixels) c.lineTo(...pixel);
  c.stroke();
}

function turned(c, [x, y], angle, drawing) {
  c.save();
  c.translate(x, y);
  c.rotate(angle);
  drawing();
  c.restore();
}
