// Paths in ned. Lines are one pixel wide in WebGL, so a path is also a band that has a width near by.
import { THREE } from "nicegui-scene";

const DASH_M = 0.45, GAP_M = 0.3, DASHES_MAX = 1500;

export class Path {
  // `dashed` tells a planned path from a flown one; `curtain` is the opacity of the wall from it down to the ground.
  constructor({ color, width, dashed = false, curtain = 0 }) {
    this.group = new THREE.Group();
    this.width = width;
    this.dashed = dashed;
    const look = { color, side: THREE.DoubleSide, fog: false };
    this.line = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color, fog: false }));
    this.band = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.MeshBasicMaterial(look));
    this.wall = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.MeshBasicMaterial({ ...look, transparent: true, opacity: curtain, depthWrite: false }));
    this.wall.visible = curtain > 0;
    for (const part of [this.line, this.band, this.wall]) {
      part.frustumCulled = false;
      this.group.add(part);
    }
  }
  // `points`: [north, east, down] each.
  set(points, heightAt) {
    const pieces = this.dashed ? dashes(points) : points.slice(1).map((point, i) => [points[i], point]);
    replace(this.line, pieces.flat(2));
    replace(this.band, pieces.flatMap(([a, b]) => bands(a, b, 0.5 * this.width)));
    if (this.wall.visible) replace(this.wall, pieces.flatMap(([a, b]) => quad(a, b, foot(b, heightAt), foot(a, heightAt))));
  }
}

function replace(part, numbers) {
  part.geometry.dispose();
  part.geometry = new THREE.BufferGeometry();
  part.geometry.setAttribute("position", new THREE.Float32BufferAttribute(numbers, 3));
}

function foot([north, east, down], heightAt) {
  return [north, east, Math.max(down, -heightAt(north, east))];
}

function quad(a, b, c, d) {
  return [...a, ...b, ...c, ...a, ...c, ...d];
}

// Two bands that cross in the path: one of them is seen from each side.
function bands(a, b, half) {
  const [n, e] = [b[0] - a[0], b[1] - a[1]], length = Math.hypot(n, e);
  const [pn, pe] = length > 1e-6 ? [(-e / length) * half, (n / length) * half] : [half, 0];
  const across = [pn, pe, 0], along = length > 1e-6 && Math.abs(b[2] - a[2]) < length ? [0, 0, half] : [-pe, pn, 0];
  return [across, along].flatMap((o) => quad(shift(a, o, 1), shift(b, o, 1), shift(b, o, -1), shift(a, o, -1)));
}

function shift(p, o, sign) {
  return [p[0] + sign * o[0], p[1] + sign * o[1], p[2] + sign * o[2]];
}

function dashes(points) {
  const lengths = points.slice(1).map((point, i) => Math.hypot(...point.map((part, k) => part - points[i][k])));
  const total = lengths.reduce((sum, length) => sum + length, 0), stretch = Math.max(1, total / (DASHES_MAX * (DASH_M + GAP_M)));
  const pieces = [];
  let left = DASH_M * stretch, isDash = true;
  lengths.forEach((length, i) => {
    const at = (s) => points[i].map((part, k) => part + (s / length) * (points[i + 1][k] - part));
    for (let s = 0; s < length; ) {
      const end = Math.min(s + left, length);
      if (isDash) pieces.push([at(s), at(end)]);
      left -= end - s;
      if (left < 1e-9) [isDash, left] = [!isDash, (isDash ? GAP_M : DASH_M) * stretch];
      s = end;
    }
  });
  return pieces;
}
