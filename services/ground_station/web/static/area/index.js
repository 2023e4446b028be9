// An area with holes that is drawn with the mouse. Rings are lists of [north, east]; the first one is the outline.

const NEAR_PX = 13; // distance from which a corner is taken hold of
const UNDO_MAX = 100;

export class AreaEditor {
  constructor() {
    this.rings = [[]];
    this.active = 0; // ring to which clicks add corners
    this.selected = null; // [ring, corner]
    this.history = [];
  }

  get corners() {
    return this.rings.reduce((sum, ring) => sum + ring.length, 0);
  }

  // The outline and the holes that have an area.
  get finished() {
    const [outline, ...holes] = this.rings;
    return [outline, ...holes.filter((hole) => hole.length > 2)];
  }

  set(rings) {
    this.remember();
    this.rings = rings.length ? rings.map((ring) => ring.map((corner) => [...corner])) : [[]];
    this.active = 0;
    this.selected = null;
  }

  remember() {
    this.history.push(JSON.stringify([this.rings, this.active]));
    if (this.history.length > UNDO_MAX) this.history.shift();
  }

  undo() {
    if (!this.history.length) return;
    [this.rings, this.active] = JSON.parse(this.history.pop());
    this.selected = null;
  }

  add(place) {
    this.remember();
    this.rings[this.active].push(place);
    this.selected = [this.active, this.rings[this.active].length - 1];
  }

  insert(ring, corner, place) {
    this.remember();
    this.rings[ring].splice(corner, 0, place);
    this.selected = [ring, corner];
  }

  remove([ring, corner]) {
    this.remember();
    this.rings[ring].splice(corner, 1);
    if (ring > 0 && !this.rings[ring].length) this.rings.splice(ring, 1);
    this.active = Math.min(this.active, this.rings.length - 1);
    this.selected = null;
  }

  move([ring, corner], place) {
    this.rings[ring][corner] = place;
  }

  // Clicks draw a new hole, or go on with the outline.
  toggleHole() {
    if (this.active > 0) {
      this.active = 0;
      this.rings = [this.rings[0], ...this.rings.slice(1).filter((hole) => hole.length)];
    } else {
      this.remember();
      this.rings.push([]);
      this.active = this.rings.length - 1;
    }
    this.selected = null;
  }

  // What is near a place on the screen: a corner, or the middle of an edge, where a corner can be added.
  near([x, y], toPixel) {
    let best = null, distance = NEAR_PX;
    const offer = (place, found) => {
      const [px, py] = toPixel(place), away = Math.hypot(px - x, py - y);
      if (away < distance) [best, distance] = [found, away];
    };
    this.rings.forEach((ring, r) => ring.forEach((corner, i) => offer(corner, { corner: [r, i] })));
    if (best) return best;
    this.edges((r, i, middle) => offer(middle, { edge: [r, i + 1] }));
    return best;
  }

  edges(visit) {
    this.rings.forEach((ring, r) => {
      if (ring.length < 3) return;
      ring.forEach(([north, east], i) => {
        const [n, e] = ring[(i + 1) % ring.length];
        visit(r, i, [(north + n) / 2, (east + e) / 2]);
      });
    });
  }

  draw(c, toPixel, handles) {
    c.beginPath();
    for (const ring of this.rings) {
      ring.forEach((corner, i) => (i ? c.lineTo(...toPixel(corner)) : c.moveTo(...toPixel(corner))));
      if (ring.length) c.closePath();
    }
    c.fillStyle = "rgba(77,210,255,.1)";
    c.fill("evenodd");
    this.rings.forEach((ring, r) => {
      c.beginPath();
      for (const corner of ring) c.lineTo(...toPixel(corner));
      c.closePath();
      c.strokeStyle = r ? "#ff8a6b" : "#4dd2ff";
      c.lineWidth = handles && r === this.active ? 2.5 : 1.5;
      c.setLineDash(r ? [6, 4] : []);
      c.stroke();
    });
    c.setLineDash([]);
    if (!handles) return;
    this.edges((r, i, middle) => dot(c, toPixel(middle), 3.5, "rgba(255,255,255,.55)", null));
    this.rings.forEach((ring, r) => {
      ring.forEach((corner, i) => {
        const chosen = this.selected?.[0] === r && this.selected?.[1] === i;
        dot(c, toPixel(corner), chosen ? 8 : 6, chosen ? "#ffd34d" : "#fff", r ? "#ff8a6b" : "#4dd2ff");
      });
    });
  }
}

function dot(c, [x, y], radius, fill, edge) {
  c.beginPath();
  c.arc(x, y, radius, 0, 7);
  c.fillStyle = fill;
  c.fill();
  if (!edge) return;
  c.strokeStyle = edge;
  c.lineWidth = 2;
  c.stroke();
}
