// The ground in ned: the simulator's terrain with what stands in it, or a level plane when nobody knows it.
import { THREE } from "nicegui-scene";
import { lightOn } from "./sky.js";

const TILE_M = 10; // side of the repeated texture; a line of the grid at each metre, a strong one at its edge
const FAR_M = 1500;
const FLAT_HALF_M = 60;
const OFFSET_MAX_M = 3, FOLLOW_SHARE = 0.05; // of the error, in each update
const PIECE = 16; // squares along the side of a piece
const DETAILS = [{ step: 1, beyond: 0 }, { step: 2, beyond: 22 }, { step: 4, beyond: 50 }]; // metres from the eye
const SAND = [0.4, 0.19, 0.1], DUST = [0.56, 0.29, 0.155], BASALT = [0.17, 0.1, 0.075]; // linear reflectances
const LEVEL = { spacing: 2 * FLAT_HALF_M, corner: [-FLAT_HALF_M, -FLAT_HALF_M, 0], columns: 2, heights_mm: [0, 0, 0, 0], rocks: [], obstacles: [] };

export class Ground {
  // `slow`: without a graphics card the light is computed once, for the corners only.
  constructor(slow) {
    this.slow = slow;
    this.group = new THREE.Group();
    this.texture = makeTexture();
    this.texture.anisotropy = slow ? 1 : 8;
    this.set(null);
  }
  // Draw a ground of the simulator; null for level ground.
  set(shape) {
    this.isTrue = shape !== null;
    this.offset = this.group.position.z = 0; // in ned, so positive down
    this.followed = false;
    this.shape = shape ?? LEVEL;
    this.group.traverse((child) => child.geometry?.dispose());
    this.group.clear();
    this.group.add(...this.makeTerrain(), this.makeFloor(), this.makePlain(), ...makeRocks(this.shape.rocks), ...this.shape.obstacles.map(makeObstacle));
  }
  // Move the ground so that it is where the altimeter measures it, or a standing vehicle feels it: the autopilot's own
  // height is wrong by some decimetres, and that of the ground in its frame with it.
  follow([north, east, down], height) {
    const error = down + height + this.heightAt(north, east);
    if (Math.abs(this.offset + error) > OFFSET_MAX_M) return;
    this.offset += this.followed ? FOLLOW_SHARE * error : error;
    this.followed = true;
    this.group.position.z = this.offset;
  }
  // Height above the world's origin, positive up, without rocks.
  heightAt(north, east) {
    const { spacing, corner, columns, heights_mm } = this.shape, rows = heights_mm.length / columns;
    const r = (north - corner[0]) / spacing, c = (east - corner[1]) / spacing, i = Math.floor(r), j = Math.floor(c);
    if (i < 0 || j < 0 || i >= rows - 1 || j >= columns - 1) return -corner[2] - this.offset;
    const at = i * columns + j, a = r - i, b = c - j;
    const south = (1 - b) * heights_mm[at] + b * heights_mm[at + 1];
    const northern = (1 - b) * heights_mm[at + columns] + b * heights_mm[at + columns + 1];
    return 0.001 * ((1 - a) * south + a * northern) - corner[2] - this.offset;
  }
  // Point at which a ray from `from` meets the ground, at most `reach` metres away.
  meet(from, direction, reach) {
    const at = (t) => from.clone().addScaledVector(direction, t);
    const above = (t) => {
      const p = at(t);
      return -p.z - this.heightAt(p.x, p.y);
    };
    const step = 0.5;
    let low = 0, high = 0;
    while (high < reach && above(high) > 0) [low, high] = [high, high + step];
    if (high >= reach) return at(reach);
    for (let i = 0; i < 8; i++) {
      const middle = 0.5 * (low + high);
      if (above(middle) > 0) low = middle;
      else high = middle;
    }
    return at(high);
  }
  // Pieces that all share one table of corners. Of a piece far away, fewer corners are drawn.
  makeTerrain() {
    const { columns, heights_mm } = this.shape, rows = heights_mm.length / columns, corners = this.makeCorners(rows, columns);
    const material = this.material(), pieces = [];
    for (let row = 0; row < rows - 1; row += PIECE) {
      for (let column = 0; column < columns - 1; column += PIECE) {
        const [lastRow, lastColumn] = [Math.min(row + PIECE, rows - 1), Math.min(column + PIECE, columns - 1)];
        pieces.push(this.makePiece(corners, material, row, column, lastRow, lastColumn));
      }
    }
    return pieces;
  }
  makeCorners(rows, columns) {
    const { spacing, corner, heights_mm } = this.shape, count = rows * columns;
    const positions = new Float32Array(3 * count), places = new Float32Array(2 * count), normals = new Float32Array(3 * count);
    const height = (row, column) => 0.001 * heights_mm[Math.min(Math.max(row, 0), rows - 1) * columns + Math.min(Math.max(column, 0), columns - 1)];
    for (let i = 0; i < count; i++) {
      const row = Math.floor(i / columns), column = i % columns, north = corner[0] + spacing * row, east = corner[1] + spacing * column;
      positions.set([north, east, corner[2] - height(row, column)], 3 * i);
      places.set([east / TILE_M, north / TILE_M], 2 * i);
      const slopeNorth = (height(row + 1, column) - height(row - 1, column)) / (2 * spacing);
      const slopeEast = (height(row, column + 1) - height(row, column - 1)) / (2 * spacing);
      new THREE.Vector3(-slopeNorth, -slopeEast, -1).normalize().toArray(normals, 3 * i);
    }
    const colours = this.colours(count, rows, columns);
    if (this.slow) bake(colours, normals);
    return {
      position: new THREE.BufferAttribute(positions, 3), normal: new THREE.BufferAttribute(normals, 3),
      uv: new THREE.BufferAttribute(places, 2), color: new THREE.BufferAttribute(colours, 3),
    };
  }
  makePiece(corners, material, row, column, lastRow, lastColumn) {
    const { spacing, corner, columns } = this.shape, piece = new THREE.LOD();
    const [north, east] = [[row, lastRow, corner[0]], [column, lastColumn, corner[1]]].map(([first, last, at]) => at + 0.5 * spacing * (first + last));
    const reach = 0.75 * spacing * Math.max(lastRow - row, lastColumn - column) + 2;
    piece.position.set(north, east, corner[2]);
    DETAILS.forEach(({ step, beyond }) => {
      const geometry = new THREE.BufferGeometry(), index = [];
      const [rowsUsed, columnsUsed] = [every(step, row, lastRow), every(step, column, lastColumn)];
      for (let i = 1; i < rowsUsed.length; i++) {
        for (let j = 1; j < columnsUsed.length; j++) {
          const [a, b] = [rowsUsed[i - 1] * columns, rowsUsed[i] * columns], [left, right] = [columnsUsed[j - 1], columnsUsed[j]];
          index.push(a + left, a + right, b + left, b + left, a + right, b + right);
        }
      }
      for (const [name, attribute] of Object.entries(corners)) geometry.setAttribute(name, attribute);
      geometry.setIndex(index);
      geometry.boundingSphere = new THREE.Sphere(new THREE.Vector3(north, east, corner[2]), reach);
      const mesh = new THREE.Mesh(geometry, material);
      mesh.position.set(-north, -east, -corner[2]);
      mesh.receiveShadow = true;
      piece.addLevel(mesh, beyond, 0.1);
    });
    return piece;
  }
  // Dust in the hollows and darker sand on the rims, as in the simulator's own pictures; patches of bare rock.
  colours(count, rows, columns) {
    const { heights_mm } = this.shape, colours = new Float32Array(3 * count);
    for (let i = 0; i < count; i++) {
      const row = Math.floor(i / columns), column = i % columns;
      let around = 0;
      for (const [dr, dc] of [[3, 0], [-3, 0], [0, 3], [0, -3]]) {
        const r = Math.min(Math.max(row + dr, 0), rows - 1), c = Math.min(Math.max(column + dc, 0), columns - 1);
        around += heights_mm[r * columns + c] / 4;
      }
      const relief = 0.012 * (heights_mm[i] - around);
      const dusty = clamp(0.5 - relief + 0.5 * noise(row / 9, column / 9) + 0.3 * noise(row / 2.3, column / 2.3));
      const bare = 0.75 * clamp(2.4 * noise(row / 6 + 40, column / 6) - 0.5);
      for (let k = 0; k < 3; k++) {
        const soil = SAND[k] + dusty * (DUST[k] - SAND[k]);
        colours[3 * i + k] = soil + bare * (BASALT[k] - soil);
      }
    }
    return colours;
  }
  // Level ground around the terrain, out to where the haze hides it.
  makePlain() {
    const { spacing, corner, columns, heights_mm } = this.shape, rows = heights_mm.length / columns;
    const [north, east] = corner, top = north + spacing * (rows - 1), right = east + spacing * (columns - 1);
    const outline = new THREE.Shape();
    for (const [x, y] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) outline.lineTo(FAR_M * x, FAR_M * y);
    const hole = new THREE.Path();
    for (const [x, y] of [[north, east], [north, right], [top, right], [top, east]]) hole.lineTo(x, y);
    outline.curves.shift();
    hole.curves.shift();
    outline.holes.push(hole);
    const geometry = new THREE.ShapeGeometry(outline), { position, uv } = geometry.attributes;
    const colours = new Float32Array(3 * position.count), normals = new Float32Array(3 * position.count);
    for (let i = 0; i < position.count; i++) {
      position.setZ(i, corner[2]);
      uv.setXY(i, position.getY(i) / TILE_M, position.getX(i) / TILE_M);
      colours.set(SAND.map((part, k) => 0.5 * (part + DUST[k])), 3 * i);
      normals.set([0, 0, -1], 3 * i);
    }
    if (this.slow) bake(colours, normals);
    geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(normals, 3));
    geometry.setIndex([...geometry.index.array].reverse());
    return new THREE.Mesh(geometry, this.material());
  }
  // Seen through the gaps between pieces of different detail.
  makeFloor() {
    const { spacing, corner, columns, heights_mm } = this.shape, rows = heights_mm.length / columns;
    const lowest = corner[2] - 0.001 * heights_mm.reduce((low, height) => Math.min(low, height), 0);
    const size = [spacing * (rows - 1), spacing * (columns - 1)];
    const floor = new THREE.Mesh(new THREE.PlaneGeometry(...size), new THREE.MeshBasicMaterial({ color: 0x9c5a36 }));
    floor.position.set(corner[0] + 0.5 * size[0], corner[1] + 0.5 * size[1], lowest + 0.05);
    floor.rotation.x = Math.PI;
    floor.renderOrder = 1;
    return floor;
  }
  material() {
    const look = { map: this.texture, vertexColors: true };
    return this.slow ? new THREE.MeshBasicMaterial(look) : new THREE.MeshLambertMaterial(look);
  }
}

function bake(colours, normals) {
  for (let i = 0; i < colours.length; i += 3) {
    lightOn(normals[i], normals[i + 1], normals[i + 2]).forEach((factor, k) => (colours[i + k] *= factor));
  }
}

function every(step, first, last) {
  const used = [];
  for (let i = first; i < last; i += step) used.push(i);
  return [...used, last];
}

function clamp(x) {
  return Math.min(Math.max(x, 0), 1);
}

function hash(i, j) {
  const x = Math.sin(127.1 * i + 311.7 * j) * 43758.5453;
  return 2 * (x - Math.floor(x)) - 1;
}

// Smooth noise from -1 to 1.
function noise(x, y) {
  const i = Math.floor(x), j = Math.floor(y), a = x - i, b = y - j;
  const u = a * a * (3 - 2 * a), v = b * b * (3 - 2 * b);
  const low = hash(i, j) + u * (hash(i + 1, j) - hash(i, j)), high = hash(i, j + 1) + u * (hash(i + 1, j + 1) - hash(i, j + 1));
  return low + v * (high - low);
}

// Rocks as dented balls, of three shapes.
function makeRocks(rocks) {
  const shapes = [1, 2, 3].map((seed) => {
    const geometry = new THREE.IcosahedronGeometry(1, 0), { position } = geometry.attributes;
    for (let i = 0; i < position.count; i++) {
      const p = new THREE.Vector3().fromBufferAttribute(position, i);
      p.multiplyScalar(1 + 0.16 * noise(2.1 * p.x + 7 * seed, 2.1 * p.y + 3 * p.z));
      position.setXYZ(i, p.x, p.y, p.z);
    }
    geometry.computeVertexNormals();
    return geometry;
  });
  return shapes.map((geometry, kind) => {
    const mine = rocks.filter((_, i) => i % shapes.length === kind);
    const mesh = new THREE.InstancedMesh(geometry, new THREE.MeshLambertMaterial({ flatShading: true }), mine.length);
    mine.forEach(([north, east, down, radius], i) => {
      const turn = new THREE.Quaternion().setFromEuler(new THREE.Euler(3 * hash(i, 1), 3 * hash(i, 2), 3 * hash(i, 3)));
      const size = new THREE.Vector3(radius, radius, radius);
      mesh.setMatrixAt(i, new THREE.Matrix4().compose(new THREE.Vector3(north, east, down), turn, size));
      const light = 0.75 + 0.25 * hash(i, 4);
      mesh.setColorAt(i, new THREE.Color().setRGB(0.27 * light, 0.15 * light, 0.1 * light));
    });
    mesh.castShadow = mesh.receiveShadow = true;
    return mesh;
  });
}

// Boxes, poles and models, with flat faces.
function makeObstacle({ colour, corners, triangles }) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
  geometry.setIndex(triangles);
  const paint = new THREE.Color().setRGB(...colour, THREE.SRGBColorSpace);
  const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: paint, flatShading: true, side: THREE.DoubleSide }));
  mesh.castShadow = mesh.receiveShadow = true;
  return mesh;
}

// Grains, ripples and small stones, and a grid of a metre.
function makeTexture() {
  const size = 1024, image = document.createElement("canvas"), metre = size / TILE_M;
  image.width = image.height = size;
  const c = image.getContext("2d");
  c.fillStyle = "#dcdcdc";
  c.fillRect(0, 0, size, size);
  let seed = 7;
  const random = () => (seed = (16807 * seed) % 2147483647) / 2147483647;
  for (let i = 0; i < 9000; i++) {
    const light = 150 + 105 * random(), radius = 0.5 + 1.8 * random(), x = size * random(), y = size * random();
    c.fillStyle = `rgba(${light},${light},${light},.35)`;
    c.fillRect(x, y, 2 * radius, radius);
  }
  for (let i = 0; i < 420; i++) {
    const radius = 0.8 + 4 * random() ** 5, x = size * random(), y = size * random(), light = 120 + 70 * random();
    dot(c, x + 0.5 * radius, y + 0.5 * radius, radius, "rgba(60,45,40,.4)");
    dot(c, x, y, radius, `rgb(${light},${light},${light})`);
  }
  c.strokeStyle = "rgba(30,14,6,.17)";
  c.lineWidth = 1.6;
  for (let i = 1; i < TILE_M; i++) {
    line(c, i * metre, 0, i * metre, size);
    line(c, 0, i * metre, size, i * metre);
  }
  c.strokeStyle = "rgba(30,14,6,.42)";
  c.lineWidth = 5; // half of it on each side of the seam
  c.strokeRect(0, 0, size, size);
  const texture = new THREE.CanvasTexture(image);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.colorSpace = THREE.SRGBColorSpace;
  return texture;
}

function dot(c, x, y, radius, colour) {
  c.fillStyle = colour;
  c.beginPath();
  c.arc(x, y, radius, 0, 7);
  c.fill();
}

function line(c, x1, y1, x2, y2) {
  c.beginPath();
  c.moveTo(x1, y1);
  c.lineTo(x2, y2);
  c.stroke();
}
