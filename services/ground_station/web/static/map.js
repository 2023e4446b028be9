// The map: north is up, metres of the world frame. Points are clicked, areas are drawn, goals and plans are shown.
import { AreaEditor } from "jezero-area";

const MIN_SCALE = 1, MAX_SCALE = 300; // pixels a metre
const GRIDS = [0.5, 1, 2, 5, 10, 20, 50, 100];
const FILE_MAX = 500_000; // bytes of an area file
const CLICK_PX = 5;

export default {
  template: `<div class="map">
    <canvas ref="canvas" tabindex="0" @pointerdown="down" @pointermove="move" @pointerup="up" @pointercancel="drag = null"
      @keydown.delete="removeSelected" @keydown.ctrl.z.prevent="edit('undo')" @wheel.prevent="wheel" @contextmenu.prevent></canvas>
    <div class="map-tools" v-if="mode === 'area'">
      <button type="button" data-mark="area-hole" :class="{ on: hole }" @click="edit('toggleHole')">{{ hole ? "Hole done" : "Draw hole" }}</button>
      <button type="button" data-mark="area-undo" :disabled="!undoable" @click="edit('undo')">Undo</button>
      <button type="button" data-mark="area-delete" :disabled="!selected" @click="removeSelected">Delete corner</button>
      <button type="button" data-mark="area-clear" :disabled="!corners" @click="edit('set', [])">Clear</button>
      <button type="button" data-mark="area-import" @click="$refs.file.click()">Import</button>
      <button type="button" data-mark="area-export" :disabled="corners < 3" @click="$emit('export')">Export</button>
      <input ref="file" type="file" hidden accept=".geojson,.json,.kml,.csv,.plan" @change="read" data-mark="area-file" />
    </div>
    <div class="map-zoom">
      <button type="button" title="closer" @click="zoom(1.5)">+</button>
      <button type="button" title="farther" @click="zoom(1 / 1.5)">−</button>
      <button type="button" title="show all" data-mark="map-fit" @click="fit">⤢</button>
      <button type="button" title="show the images on the ground" data-mark="map-photos" :class="{ on: photos }"
        @click="$emit('photos', !photos)">▦</button>
    </div>
    <div class="map-place">{{ place }}</div>
  </div>`,
  props: { robot: Object, photos: Boolean },
  data() {
    return { place: "", mode: "look", hole: false, undoable: false, selected: false, corners: 0 };
  },
  mounted() {
    Object.assign(this, { center: [0, 0], scale: 40, trail: [], fence: [], plan: null, goal: null, point: null, state: null, drag: null });
    this.area = new AreaEditor();
    this.sizes = new ResizeObserver(() => this.draw());
    this.sizes.observe(this.$el);
  },
  unmounted() {
    this.sizes.disconnect();
  },
  watch: {
    photos() {
      this.draw();
    },
  },
  methods: {
    update(state) {
      this.state = state;
      this.draw();
    },
    setTrail(points) {
      this.trail = points;
    },
    // The zones in force: [{name, keep_in, corners}].
    setFence(zones) {
      this.fence = zones;
    },
    // What this page plans: {path, pictures}.
    setPlan(plan) {
      this.plan = plan;
      this.draw();
    },
    // The goal that is flown, of whichever client: {path, pictures, taken}.
    setGoal(goal) {
      this.goal = { ...goal, taken: new Set(goal.taken) };
      this.draw();
    },
    setMosaic(mosaic) {
      if (!mosaic || mosaic.url === this.mosaic?.url) return;
      const image = new Image();
      image.onload = () => {
        this.mosaic = { ...mosaic, image };
        this.draw();
      };
      image.src = mosaic.url;
    },
    setMode(mode) {
      this.mode = mode;
      this.$refs.canvas.style.cursor = mode === "look" ? "grab" : "crosshair";
      this.draw();
    },
    setPoint(point) {
      this.point = point;
      this.draw();
    },
    // -- the area --
    setArea(rings) {
      this.area.set(rings);
      this.changed(false);
      if (rings.length) this.fit();
    },
    // What the browser keeps for the next load of the page: the area, the open tab, the view.
    keep(name, value) {
      localStorage.setItem(`jezero-${name}`, JSON.stringify(value));
    },
    kept() {
      return Object.fromEntries(["area", "tab", "view"].map((name) => [name, parsed(localStorage.getItem(`jezero-${name}`))]));
    },
    edit(what, ...args) {
      this.area[what](...args);
      this.changed(what !== "toggleHole");
    },
    removeSelected() {
      if (this.area.selected) this.edit("remove", this.area.selected);
    },
    changed(emits) {
      const { active, history, selected, corners } = this.area;
      Object.assign(this, { hole: active > 0, undoable: history.length > 0, selected: !!selected, corners });
      if (emits) this.$emit("area", this.area.finished);
      this.draw();
    },
    async read(event) {
      const file = event.target.files[0];
      event.target.value = "";
      if (!file) return;
      if (file.size > FILE_MAX) this.$emit("file", { name: file.name, size: file.size, text: "" });
      else this.$emit("file", { name: file.name, size: file.size, text: await file.text() });
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
    at(event) {
      const box = this.$el.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    },
    // -- pointer --
    down(event) {
      this.$refs.canvas.setPointerCapture(event.pointerId);
      const found = this.mode === "area" && event.button !== 1 ? this.area.near(this.at(event), (place) => this.toPixel(place)) : null;
      this.drag = { x: event.clientX, y: event.clientY, center: [...this.center], moved: false, ...found };
    },
    move(event) {
      const place = this.toPlace(event), drag = this.drag;
      this.place = `${place[0].toFixed(1)} m north, ${place[1].toFixed(1)} m east`;
      if (!drag) return;
      const dx = event.clientX - drag.x, dy = event.clientY - drag.y;
      if (!drag.moved && Math.hypot(dx, dy) > CLICK_PX) {
        drag.moved = true;
        if (drag.corner) this.area.remember();
        if (drag.edge) {
          this.area.insert(...drag.edge, place);
          drag.corner = drag.edge;
        }
        if (drag.corner) this.area.selected = drag.corner;
      }
      if (!drag.moved) return;
      if (drag.corner) this.area.move(drag.corner, place);
      else this.center = [drag.center[0] + dy / this.scale, drag.center[1] - dx / this.scale];
      this.draw();
    },
    up(event) {
      const drag = this.drag;
      this.drag = null;
      if (!drag) return;
      if (drag.moved) {
        if (drag.corner) this.changed(true);
        return;
      }
      const place = this.toPlace(event);
      if (this.mode === "point" && event.button === 0) this.$emit("point", place);
      else if (this.mode === "area") this.click(drag, place, event.button);
      this.draw();
    },
    click({ corner, edge }, place, button) {
      if (corner && button === 2) this.edit("remove", corner);
      else if (button !== 0) return;
      else if (edge) this.edit("insert", ...edge, place);
      else if (!corner) this.edit("add", place);
      else {
        this.area.selected = corner;
        this.changed(false);
      }
    },
    zoom(factor) {
      this.scale = Math.min(MAX_SCALE, Math.max(MIN_SCALE, this.scale * factor));
      this.draw();
    },
    fit() {
      const places = [...this.area.rings.flat(), ...this.fence.flatMap((zone) => zone.corners), ...(this.plan?.path ?? []), ...(this.goal?.path ?? [])];
      for (const thing of [this.state?.vehicle, this.state?.rover]) if (thing) places.push(thing.pos);
      if (!places.length || !this.$el.clientWidth) return;
      const [norths, easts] = [0, 1].map((axis) => places.map((place) => place[axis]));
      const [top, bottom, right, left] = [Math.max(...norths), Math.min(...norths), Math.max(...easts), Math.min(...easts)];
      this.center = [(top + bottom) / 2, (left + right) / 2];
      const scale = Math.min(this.$el.clientHeight / (top - bottom + 4), this.$el.clientWidth / (right - left + 4));
      this.scale = Math.min(60, Math.max(MIN_SCALE, 0.9 * scale));
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
      c.setTransform(1, 0, 0, 1, 0, 0);
      c.drawImage(this.ground(w, h, ratio), 0, 0);
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      for (const zone of this.fence) this.drawZone(c, zone);
      this.area.draw(c, (place) => this.toPixel(place), this.mode === "area");
      if (this.plan && !this.goal?.path.length) this.drawFlight(c, this.plan, "#ffd34d");
      if (this.goal) this.drawFlight(c, this.goal, "#ffa63d");
      this.drawLine(c, this.trail, "#2f9bff", 2.5);
      this.drawRover(c);
      this.drawPoint(c);
      this.drawVehicle(c);
    },
    // The ground with its images and the grid, drawn again only when the view or the images change.
    ground(w, h, ratio) {
      const view = [w, h, ratio, this.scale, ...this.center, this.photos && this.mosaic?.url].join();
      if (view === this.groundView) return this.groundCanvas;
      this.groundView = view;
      this.groundCanvas ??= document.createElement("canvas");
      [this.groundCanvas.width, this.groundCanvas.height] = [w * ratio, h * ratio];
      const c = this.groundCanvas.getContext("2d", { willReadFrequently: true });
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      c.fillStyle = "#5a3524";
      c.fillRect(0, 0, w, h);
      this.drawMosaic(c);
      this.drawGrid(c, w, h);
      return this.groundCanvas;
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
    // A zone to stay in is an outline, one to stay out of is hatched.
    drawZone(c, { name, keep_in, corners }) {
      const pixels = corners.map((corner) => this.toPixel(corner));
      const [xs, ys] = [0, 1].map((axis) => pixels.map((pixel) => pixel[axis]));
      const { clientWidth: w, clientHeight: h } = this.$el;
      const [left, top] = [Math.max(0, Math.min(...xs)), Math.max(0, Math.min(...ys))];
      const [right, bottom] = [Math.min(w, Math.max(...xs)), Math.min(h, Math.max(...ys))];
      c.save();
      c.beginPath();
      for (const pixel of pixels) c.lineTo(...pixel);
      c.closePath();
      c.strokeStyle = keep_in ? "#3ddc84" : "#ff5a4d";
      c.fillStyle = c.strokeStyle;
      c.lineWidth = 2.5;
      c.stroke();
      if (!keep_in) {
        c.clip();
        c.lineWidth = 1;
        for (let x = left - bottom + top; x < right; x += 10) stroke(c, [[x, bottom], [x + bottom - top, top]]);
      }
      c.restore();
      c.font = "12px system-ui";
      c.textAlign = "left";
      c.fillStyle = keep_in ? "#3ddc84" : "#ff8a80";
      c.fillText(name, left + 4, keep_in ? top + 14 : top - 6);
    },
    drawMosaic(c) {
      if (!this.mosaic || !this.photos) return;
      const { north, east, height, width, image } = this.mosaic;
      c.drawImage(image, ...this.toPixel([north, east]), width * this.scale, height * this.scale);
    },
    // A path, and a mark where each image is to be taken; a taken one is full.
    drawFlight(c, { path, pictures, taken }, color) {
      c.setLineDash([8, 5]);
      this.drawLine(c, path, color, 2);
      c.setLineDash([]);
      pictures.forEach((place, index) => {
        const [x, y] = this.toPixel(place);
        c.beginPath();
        c.arc(x, y, 3.5, 0, 7);
        c.fillStyle = taken?.has(index) ? "#3ddc84" : "rgba(13,17,23,.75)";
        c.strokeStyle = taken?.has(index) ? "#0d1117" : color;
        c.lineWidth = 1.5;
        c.fill();
        c.stroke();
      });
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

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

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
