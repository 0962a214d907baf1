// Drawing a scene in space by a camera far away, which the mouse turns. Points are x, y, z in a flat array.

const BEHIND = 0.3; // opacity of what the object hides
const PARALLEL = 1e-6; // sine of the angle between a face and a line of sight below which they are parallel
const ROOM = 66; // pixels around the window, for ticks and labels
const SHORTEST_AXIS = 30; // pixels; a shorter one has no ticks
const DEGREES = 0.5; // by which the camera turns per pixel
const SHORTEST_ARROW = 12; // pixels; a shorter one has no head
const NAMES = ["d₁", "d₂", "d₃"];

const dot3 = (a, b, first = 0) => a[first] * b[0] + a[first + 1] * b[1] + a[first + 2] * b[2];

/** Directions to the right, upwards and to the eye for an elevation and an azimuth in degrees; see plot/view.py. */
function cameraAt([elevation, azimuth]) {
  const [sinUp, cosUp, sin, cos] = [elevation, azimuth].flatMap((degrees) =>
    // Rounded, so that projections look exactly along an axis.
    [Math.sin, Math.cos].map((part) => Math.round(1e12 * part((degrees * Math.PI) / 180)) / 1e12),
  );
  return { right: [cos, 0, -sin], up: [-sinUp * sin, cosUp, -sinUp * cos], eye: [cosUp * sin, sinUp, cosUp * cos] };
}

/** The angles of a camera after the mouse has moved by some pixels: the object follows the mouse. */
function turned([elevation, azimuth], across, down) {
  return [Math.min(Math.max(elevation + DEGREES * down, -90), 90), azimuth - DEGREES * across];
}

/** Returns a function from points to positions on a canvas, which the window of a picture fills. */
function projection({ width, height }, [low, high], { right, up }) {
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => low.map((value, axis) => ((k >> axis) & 1 ? high[axis] : value)));
  const [west, east] = extremes(corners.map((corner) => dot3(corner, right)));
  const [south, north] = extremes(corners.map((corner) => dot3(corner, up)));
  const scale = Math.min((width - 2 * ROOM) / (east - west), (height - 2 * ROOM) / (north - south));
  const [x, y] = [width / 2 - (scale * (west + east)) / 2, height / 2 + (scale * (south + north)) / 2];
  return (points, k = 0) => [x + scale * dot3(points, right, 3 * k), y - scale * dot3(points, up, 3 * k)];
}

/** The faces of the window behind everything, with a grid, and ticks and labels along its edges. */
function drawWindow({ context, ink }, { window: ends, labels }, project, eye) {
  const [low, high] = ends;
  const longest = Math.max(...high.map((value, axis) => value - low[axis]));
  const values = low.map((value, axis) => ticks([value, high[axis]], (4 * (high[axis] - value)) / longest));
  const point = (...coordinates) => {
    const at = [0, 0, 0];
    for (const [axis, value] of coordinates) at[axis] = value;
    return project(at);
  };
  const faces = (axis, side) => (side ? eye[axis] : -eye[axis]) > 0;
  const middle = project(low.map((value, axis) => (value + high[axis]) / 2));
  for (const axis of [0, 1, 2]) {
    const others = [(axis + 1) % 3, (axis + 2) % 3];
    const behind = [axis, eye[axis] > 0 ? low[axis] : high[axis]];
    for (const [along, across] of eye[axis] ? [others, [...others].reverse()] : []) {
      const lineAt = (value) =>
        [low, high].flatMap((end) => point(behind, [along, value], [across, end[across]]));
      for (const [value] of values[along]) segment(context, lineAt(value), ink, { alpha: 0.12 });
      for (const end of ends) segment(context, lineAt(end[along]), ink, { alpha: 0.4 });
    }
    // Ticks are on an edge between a face in front and a face behind: the lowest one, or the one on the left.
    const edges = [0, 1, 2, 3].map((k) => [k & 1, k >> 1]);
    const sides = edges.filter(([first, second]) => faces(others[0], first) !== faces(others[1], second));
    const lines = sides.map((side) => (value) =>
      point([axis, value], ...others.map((other, k) => [other, ends[side[k]][other]])),
    );
    drawTicks(context, lines, { values: values[axis], ends: [low[axis], high[axis]], label: labels["xyz"[axis]] }, middle);
  }
}

function drawTicks(context, lines, { values, ends, label }, middle) {
  const between = (line) => line((ends[0] + ends[1]) / 2);
  const [from, to] = lines.length ? ends.map(lines[0]) : [[0, 0], [0, 0]];
  const [right, down] = [to[0] - from[0], to[1] - from[1]];
  const length = Math.hypot(right, down);
  if (length < SHORTEST_AXIS) return;
  const upright = Math.abs(down) > Math.abs(right);
  const place = (line) => (upright ? -between(line)[0] : between(line)[1]);
  const line = lines.reduce((best, other) => (place(other) > place(best) ? other : best));
  const [x, y] = between(line);
  const side = (x - middle[0]) * -down + (y - middle[1]) * right < 0 ? -1 : 1;
  const out = [(side * -down) / length, (side * right) / length];
  context.textAlign = "center";
  context.textBaseline = "middle";
  let widest = 0;
  for (const [value, text] of values) {
    const [across, up] = line(value);
    const half = context.measureText(text).width / 2;
    const away = 6 + Math.abs(out[0]) * half + Math.abs(out[1]) * 7;
    context.fillText(text, across + away * out[0], up + away * out[1]);
    widest = Math.max(widest, away + Math.abs(out[0]) * half);
  }
  context.save();
  context.translate(x + (widest + 16) * out[0], y + (widest + 16) * out[1]);
  if (upright) context.rotate(-Math.PI / 2);
  context.fillText(label, 0, 0);
  context.restore();
}

/** Draw the faces of the objects that are turned towards the eye, their silhouettes and the edges of their cuts. */
function drawBody(sheet, picture, project, eye) {
  const { corners, shades, faces, part } = picture;
  const nearest = new Array(shades.length ? part[shades.length - 1] + 1 : 0).fill(-Infinity); // corner of each object
  faces.forEach((corner, k) => {
    const own = part[Math.floor(k / 3)];
    nearest[own] = Math.max(nearest[own], dot3(corners, eye, 3 * corner));
  });
  const order = [...nearest.keys()].sort((one, other) => nearest[one] - nearest[other]);
  for (const own of order) drawObject(sheet, picture, project, eye, own);
}

function drawObject({ context, ink }, picture, project, eye, own) {
  const { corners, normals, shades, faces, edges, beside, sharp, part } = picture;
  const seen = shades.map((_, face) => dot3(normals, eye, 3 * face) > 0);
  const bright = ink.match(/\d+/g).slice(0, 3).reduce((sum, part) => sum + Number(part), 0) > 384;
  const at = Array.from({ length: corners.length / 3 }, (_, k) => project(corners, k));
  const paths = new Map(); // by grey, because many small paths are slow
  for (let face = 0; face < shades.length; face++) {
    if (!seen[face] || part[face] !== own) continue;
    const grey = 2 * Math.round(127 * (bright ? shades[face] - 0.6 : shades[face]));
    if (!paths.has(grey)) paths.set(grey, new Path2D());
    const [first, second, third] = faces.subarray(3 * face, 3 * face + 3);
    const path = paths.get(grey);
    path.moveTo(...at[first]);
    path.lineTo(...at[second]);
    path.lineTo(...at[third]);
    path.closePath();
  }
  context.lineWidth = 0.8;
  for (const [grey, path] of paths) {
    context.fillStyle = context.strokeStyle = `rgb(${grey}, ${grey}, ${grey})`;
    context.fill(path);
    context.stroke(path); // otherwise seams between faces would show
  }
  context.beginPath();
  for (let edge = 0; edge < sharp.length; edge++) {
    if (part[beside[2 * edge]] !== own) continue;
    const [one, other] = [seen[beside[2 * edge]], seen[beside[2 * edge + 1]]];
    if (one === other && !(sharp[edge] && one)) continue;
    context.moveTo(...at[edges[2 * edge]]);
    context.lineTo(...at[edges[2 * edge + 1]]);
  }
  [context.strokeStyle, context.lineWidth] = [ink, 1];
  context.stroke();
}

/** Returns a function that tells whether an object hides a point from the eye; see `hides` in plot/body.py. */
function hiding({ normals, offsets, part }, eye) {
  const objects = [];
  for (let face = 0; face < (offsets?.length ?? 0); face++) {
    const plane = [normals.subarray(3 * face, 3 * face + 3), offsets[face], dot3(normals, eye, 3 * face)];
    (objects[part[face]] ??= []).push(plane);
  }
  const hides = (faces, points, k) => {
    let [enters, leaves] = [0, Infinity]; // distances of the object along the line of sight
    for (const [normal, offset, rate] of faces) {
      const off = dot3(points, normal, 3 * k) + offset;
      if (rate > PARALLEL) leaves = Math.min(leaves, -off / rate);
      else if (rate < -PARALLEL) enters = Math.max(enters, -off / rate);
      else if (off > 0) return false;
      if (enters >= leaves) return false;
    }
    return true;
  };
  return (points, k) => objects.some((faces) => hides(faces, points, k));
}

/** Draw the scene in space at a step, seen by a camera; `failure` is the reason if the step has no state. */
function drawSpace(canvas, picture, step, failure, angles) {
  const sheet = cleared(canvas);
  const { context, width, ink } = sheet;
  const { whiskers, points, steps, line: lines, drive, directors, contacts, ways, forces } = picture;
  const most = contacts.length / (3 * steps * whiskers); // contacts of a whisker
  const camera = cameraAt(angles);
  const project = projection(sheet, picture.window, camera);
  const hidden = hiding(picture, camera.eye);
  /** A line through points of which one is k(0), the next k(1) and so on: pale where the object hides it. */
  const solid = (array, count, k, style, thick, dashes = []) => {
    const places = Array.from({ length: count }, (_, index) => project(array, k(index)));
    const seen = places.map(([x, y], index) => (hidden(array, k(index)) ? [NaN, NaN] : [x, y]));
    context.setLineDash(dashes);
    for (const [alpha, shown] of [[BEHIND, places], [1, seen]]) {
      context.globalAlpha = alpha;
      line(context, count, (index) => shown[index][0], (index) => shown[index][1], style, thick);
    }
    context.setLineDash([]);
  };
  const point = (array, k, style, radius) => dot(context, ...project(array, k), radius, style);
  /** An arrow, without a head if it is short; returns whether it is long. */
  const arrowBetween = (from, to, style, look) => {
    const long = Math.hypot(to[0] - from[0], to[1] - from[1]) > SHORTEST_ARROW;
    if (long) arrow(context, from, to, style, look);
    else segment(context, [...from, ...to], style, look);
    return long;
  };

  // What does not move is drawn once for each view.
  const key = [canvas.width, canvas.height, ink, ...angles].join();
  if (picture.layer?.key === key) {
    context.drawImage(picture.layer.image, 0, 0, width, sheet.height);
  } else {
    context.fillStyle = ink;
    drawWindow(sheet, picture, project, camera.eye);
    if (picture.corners) drawBody(sheet, picture, project, camera.eye);
    for (let contact = 0; contact < whiskers * most; contact++) {
      const style = colour(Math.floor(contact / most), ink);
      solid(ways, steps, (k) => k * whiskers * most + contact, style, 1, [1, 4]);
    }
    const image = make("canvas", { width: canvas.width, height: canvas.height });
    image.getContext("2d").drawImage(canvas, 0, 0);
    picture.layer = { key, image };
  }
  picture.rigid.forEach((rigid, spring) => {
    const array = picture[`spring_${spring}`];
    const count = array.length / steps / 3;
    solid(array, count, (k) => step * count + k, ink, rigid ? 3 : 1.2);
  });
  const [x, y] = project(drive, step);
  context.fillStyle = ink;
  context.fillRect(x - 4.5, y - 4.5, 9, 9);
  for (let at = step * whiskers; at < (step + 1) * whiskers; at++) {
    const style = colour(at - step * whiskers, ink);
    const base = lines.subarray(3 * at * points, 3 * at * points + 3);
    const beside = (place) => {
      // Row k of the directors holds their components along axis k.
      return project([...base].map((value, axis) => value + picture.director * dot3(directors, place, 9 * at + 3 * axis)));
    };
    NAMES.forEach((name, k) => {
      const tip = beside([0, 1, 2].map((director) => Number(director === k)));
      if (!Number.isFinite(tip[0]) || !arrowBetween(project(base), tip, ink, { size: 7, width: 1 })) return;
      [context.textAlign, context.textBaseline, context.fillStyle] = ["center", "middle", ink];
      context.fillText(name, ...beside(picture.namePlaces[k]));
    });
    solid(lines, points, (k) => at * points + k, style, 2.5);
    point(base, 0, style, 4);
    for (let contact = at * most; contact < (at + 1) * most; contact++) {
      point(contacts, contact, style, 3);
      const [tail, head] = [project(forces, 2 * contact), project(forces, 2 * contact + 1)];
      if (Number.isFinite(tail[0])) arrowBetween(tail, head, style, { width: 1.8 });
    }
  }
  if (failure) {
    [context.fillStyle, context.textAlign] = [ink, "center"];
    context.fillText(failure, width / 2, 30);
  }
}
