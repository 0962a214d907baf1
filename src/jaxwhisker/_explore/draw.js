// Drawing on canvases: the scene in the plane at one step of a picture, and the signals over the control or the time.

const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"]; // Okabe and Ito; then text colour
const MARGINS = { left: 76, right: 14 }; // of the axes in a canvas
const LINE = 13; // pixels between two lines of text

function extremes(values, low = Infinity, high = -Infinity) {
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

/** Returns a function from the step to the ranges of x and y to draw, rounded to tenths of a whisker length. */
function viewOf(picture) {
  const { length, steps } = picture;
  const tenth = 0.1 * length;
  const hanging = 0.8 * tenth * picture.springs.filter(({ between: [first, second] }) => second - first > 1).length;
  const span = (from, to, below, ...columns) => {
    const part = (values) => values.subarray((from * values.length) / steps, (to * values.length) / steps);
    const [low, high] = columns.reduce((range, values) => extremes(part(values), ...range), []);
    return [tenth * Math.floor((low - below) / tenth - 1), tenth * Math.ceil(high / tenth + 1)];
  };
  const whole = [
    span(0, steps, 0, picture.line_x, picture.drive_x),
    span(0, steps, hanging, picture.line_y, picture.drive_y),
  ];
  if (whole.every(([low, high]) => high - low < 6 * length)) return () => whole;
  // Very soft springs stretch over many lengths: follow the whiskers and leave the drive out.
  const near = (step) => [span(step, step + 1, 0, picture.line_x), span(step, step + 1, hanging, picture.line_y)];
  return (step) => (Number.isFinite(picture.line_x[step * picture.whiskers * picture.points]) ? near(step) : whole);
}

/** Clear a canvas and match its resolution to the screen. */
function cleared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  const size = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  const { color: ink, fontFamily } = getComputedStyle(canvas);
  context.font = `12px ${fontFamily}`;
  context.lineJoin = context.lineCap = "round";
  return { context, width, height, ink };
}

const colour = (whisker, ink) => COLOURS[whisker % (COLOURS.length + 1)] ?? ink;

/** Draw a line through points; NaN leaves a gap. */
function line(context, count, x, y, style, width) {
  context.beginPath();
  for (let k = 0, connected = false; k < count; k++) {
    const [right, down] = [x(k), y(k)];
    const known = Number.isFinite(right + down);
    if (known) connected ? context.lineTo(right, down) : context.moveTo(right, down);
    connected = known;
  }
  context.strokeStyle = style;
  context.lineWidth = width;
  context.stroke();
}

function segment(context, [x0, y0, x1, y1], style, { width = 1, alpha = 1, dashes = [] } = {}) {
  context.globalAlpha = alpha;
  context.setLineDash(dashes);
  line(context, 2, (k) => (k ? x1 : x0), (k) => (k ? y1 : y0), style, width);
  context.setLineDash([]);
  context.globalAlpha = 1;
}

function dot(context, x, y, radius, style) {
  if (!Number.isFinite(x + y)) return;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = style;
  context.fill();
}

function arrow(context, [x0, y0], [x1, y1], style, { size = 10, width = 1.8 } = {}) {
  const angle = Math.atan2(y1 - y0, x1 - x0);
  const back = (distance, turn) => [x1 - distance * Math.cos(angle + turn), y1 - distance * Math.sin(angle + turn)];
  segment(context, [x0, y0, ...back(0.8 * size, 0)], style, { width });
  context.beginPath();
  for (const corner of [[x1, y1], back(size, 0.4), back(size, -0.4)]) context.lineTo(...corner);
  context.fillStyle = style;
  context.fill();
}

/** About `count` round values in a range, each with its text. */
function ticks([low, high], count) {
  const rough = (high - low) / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= 0.999 * rough);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const text = (value) => {
    if (digits <= 4 && Math.max(-low, high) < 1e5) return value.toFixed(digits);
    return value ? Number(value.toPrecision(4)).toExponential() : "0";
  };
  const [first, last] = [Math.ceil(low / step - 1e-9), Math.floor(high / step + 1e-9)];
  return Array.from({ length: last - first + 1 }, (_, k) => [(first + k) * step, text((first + k) * step)]);
}

/** Draw axes in a box; returns functions from values to positions on the canvas. */
function axes({ context, width, ink }, { left, right, top, bottom }, x, y, labels) {
  const X = (value) => left + ((value - x[0]) / (x[1] - x[0])) * (right - left);
  const Y = (value) => bottom - ((value - y[0]) / (y[1] - y[0])) * (bottom - top);
  const write = (text, x, y, align, baseline, room = undefined) => {
    [context.fillStyle, context.textAlign, context.textBaseline] = [ink, align, baseline];
    const half = align === "center" ? context.measureText(text).width / 2 : 0;
    context.fillText(text, Math.min(x, width - half), y, room);
  };
  for (const [value, text] of ticks(y, Math.max((bottom - top) / 40, 2.5))) {
    segment(context, [left, Y(value), right, Y(value)], ink, { alpha: 0.12 });
    write(text, left - 6, Y(value), "right", "middle");
  }
  for (const [value, text] of ticks(x, (right - left) / 70)) {
    segment(context, [X(value), top, X(value), bottom], ink, { alpha: 0.12 });
    if (labels.x) write(text, X(value), bottom + 5, "center", "top");
  }
  if (labels.x) write(labels.x, (left + right) / 2, bottom + 21, "center", "top");
  context.save();
  context.translate(left - 54, (top + bottom) / 2);
  context.rotate(-Math.PI / 2);
  // A label that is longer than its axis has its unit on a second line, condensed if necessary.
  const room = bottom - top;
  const lines = context.measureText(labels.y).width > room ? labels.y.split(/ (?=\()/) : [labels.y];
  lines.forEach((text, k) => write(text, 0, (k + 1 - lines.length) * LINE, "center", "middle", room));
  context.restore();
  context.globalAlpha = 0.4;
  [context.strokeStyle, context.lineWidth] = [ink, 1];
  context.strokeRect(left, top, right - left, bottom - top);
  context.globalAlpha = 1;
  return { X, Y };
}

/** Draw the scene at a step; `failure` is the reason if the step has no state. */
function drawScene(canvas, picture, step, failure) {
  const sheet = cleared(canvas);
  const { context, width, height, ink } = sheet;
  const box = { left: MARGINS.left, right: width - MARGINS.right, top: 8, bottom: height - 40 };
  const [[west, east], [south, north]] = picture.viewAt(step);
  // The same scale for both axes; a larger box shows more of the surroundings.
  const scale = Math.min((box.right - box.left) / (east - west), (box.bottom - box.top) / (north - south));
  const wider = (box.right - box.left) / scale - (east - west);
  const taller = (box.bottom - box.top) / scale - (north - south);
  const [x, y] = [[west - wider / 2, east + wider / 2], [south - 0.3 * taller, north + 0.7 * taller]];
  const { X, Y } = axes(sheet, box, x, y, picture.labels);
  context.save();
  context.beginPath();
  context.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
  context.clip();

  const outline = [(k) => X(picture.outline_x[k]), (k) => Y(picture.outline_y[k])];
  line(context, picture.outline_x.length, ...outline, ink, 0.8);
  context.globalAlpha = 0.18;
  context.fillStyle = ink;
  context.fill();
  context.globalAlpha = 0.7;
  for (const { points, rigid } of springs(picture, step)) {
    line(context, points.length, (k) => X(points[k][0]), (k) => Y(points[k][1]), ink, rigid ? 3 : 1.2);
  }
  context.globalAlpha = 1;
  context.fillStyle = ink;
  context.fillRect(X(picture.drive_x[step]) - 4.5, Y(picture.drive_y[step]) - 4.5, 9, 9);
  for (let whisker = 0; whisker < picture.whiskers; whisker++) {
    drawWhisker(context, picture, step * picture.whiskers + whisker, X, Y, colour(whisker, ink));
  }
  context.restore();
  if (failure) {
    [context.fillStyle, context.textAlign] = [ink, "center"];
    context.fillText(failure, (box.left + box.right) / 2, box.top + 30);
  }
}

/** Indices of the contacts of a whisker in their arrays: the outermost one, and others that touch. */
function contactsAt(picture, at) {
  const most = picture.phase.length / (picture.steps * picture.whiskers);
  return Array.from({ length: most }, (_, k) => at * most + k).filter((k, number) => !number || picture.phase[k]);
}

/** Draw a whisker, its base and the forces on it; `at` is its index in the arrays of states. */
function drawWhisker(context, picture, at, X, Y, style) {
  const first = at * picture.points;
  const points = [(k) => X(picture.line_x[first + k]), (k) => Y(picture.line_y[first + k])];
  line(context, picture.points, ...points, style, 2.5);
  dot(context, X(picture.base_x[at]), Y(picture.base_y[at]), 4, style);
  for (const k of contactsAt(picture, at)) {
    const share = Math.min(picture.contact_force[k] / picture.largestForce, 1);
    if (!(share > 0)) continue;
    const [slope, reach] = [picture.contact_slope[k], (0.1 + 0.25 * share) * picture.length];
    const [tipX, tipY] = [picture.contact_x[k], picture.contact_y[k]];
    const tail = [X(tipX - reach * Math.sin(slope)), Y(tipY + reach * Math.cos(slope))];
    arrow(context, tail, [X(tipX), Y(tipY)], style);
  }
}

/** Points of the springs along the axes of the drive's frame: zigzags, and spirals for torsion springs. */
function springs(picture, step) {
  const [x, y, turned] = [picture.drive_x[step], picture.drive_y[step], picture.drive_angle[step]];
  const [cos, sin] = [Math.cos(turned), Math.sin(turned)];
  const poses = [[0, 0, 0]];
  for (let at = step * picture.whiskers; at < (step + 1) * picture.whiskers; at++) {
    const [right, up] = [picture.base_x[at] - x, picture.base_y[at] - y];
    poses.push([right * cos + up * sin, up * cos - right * sin, picture.base_angle[at] - turned]);
  }
  let hanging = 0;
  return picture.springs.map((spring) => {
    const [first, second] = spring.between;
    const passing = spring.axis === "x" && Math.abs(second - first) > 1;
    // A spring that passes other bases hangs below them.
    const level = passing ? picture.lowest - 0.08 * picture.length * ++hanging : undefined;
    const shape = spring.axis === "phi" ? spiral : zigzag;
    const points = shape(poses[first], poses[second], spring, picture.length, level);
    return { rigid: spring.rigid, points: points.map(([a, b]) => [x + cos * a - sin * b, y + sin * a + cos * b]) };
  });
}

function zigzag(here, there, { axis, offset, short, rigid }, unit, level) {
  const along = axis === "x" ? 0 : 1;
  level ??= there[1 - along];
  const swing = 0.018 * unit;
  // A spring with almost no rest length begins at a wall that moves with the drive.
  const start = here[along] + offset[along] - (short ? 0.16 * unit : 0);
  const wall = [[start, level - 2 * swing], [start, level + 2 * swing], [start, level]];
  const head = short ? wall : [[here[along], here[1 - along]], [here[along], level]];
  // Straight ends with six turns between them. The number of turns is fixed, which makes stretching visible.
  const turns = Array.from({ length: 12 }, (_, k) => [0.2 + 0.05 * (k + 0.5), (rigid ? 0 : swing) * (k % 2 ? -1 : 1)]);
  const shares = [[0, 0], [0.2, 0], ...turns, [0.8, 0], [1, 0]];
  const body = shares.map(([share, off]) => [start + share * (there[along] - start), level + off]);
  const points = [...head, ...body, [there[along], there[1 - along]]];
  return along === 0 ? points : points.map(([a, b]) => [b, a]);
}

/** Points of a spiral: its inner end turns with the base, its outer end with the other end of the spring. */
function spiral(here, there, { offset, rigid }, unit) {
  const outer = here[2] - Math.PI / 4;
  const wound = rigid ? 0 : there[2] - here[2] - offset[2] - 4.5 * Math.PI;
  const at = (radius, angle) => [there[0] + radius * Math.cos(angle), there[1] + radius * Math.sin(angle)];
  const turns = Array.from({ length: 97 }, (_, k) => at((0.085 * unit * k) / 96, outer + (1 - k / 96) * wound));
  return [...turns, at(0.12 * unit, outer)];
}

function drawSignals(canvas, picture, step) {
  const sheet = cleared(canvas);
  const { context, width, height, ink } = sheet;
  const { signals } = picture;
  const row = (height - 40) / signals.length;
  signals.forEach((name, number) => {
    const [top, bottom] = [8 + number * row, (number + 1) * row - 6];
    const box = { left: MARGINS.left, right: width - MARGINS.right, top, bottom };
    const last = number === signals.length - 1;
    const labels = { x: last && picture.labels[picture.symbol], y: picture.labels[name] };
    const { X, Y } = axes(sheet, box, picture.range, rounded(extremes(picture[name]), picture.least?.[name]), labels);
    for (const { place, whiskers, snap } of picture.events) {
      const style = whiskers.length === 1 ? colour(whiskers[0], ink) : ink;
      const look = snap ? { alpha: 0.8, dashes: [4, 4] } : { width: 2 };
      segment(context, [X(place), snap ? top : bottom - 7, X(place), bottom], style, look);
    }
    const now = X(picture.along[step]);
    segment(context, [now, top, now, bottom], ink, { alpha: 0.8 });
    for (let whisker = 0; whisker < picture.whiskers; whisker++) {
      const style = colour(whisker, ink);
      const value = (k) => Y(picture[name][k * picture.whiskers + whisker]);
      line(context, picture.steps, (k) => X(picture.along[k]), value, style, 1.8);
      dot(context, now, value(step), 3.5, style);
    }
  });
}

/** A slightly larger range with round ends, which small changes of the values do not move; at least so large. */
function rounded([low, high], least = 0) {
  if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
  if (!(high - low > 1e-9 * Math.abs(high))) return Number.isFinite(low) ? [low - 0.5, low + 0.5] : [-0.5, 0.5];
  const unit = 10 ** Math.floor(Math.log10(high - low)) / 2;
  const room = 0.08 * (high - low);
  return [Math.floor((low - room) / unit) * unit, Math.ceil((high + room) / unit) * unit];
}
