// Drawing on canvas: the scene at a step of a reply, and the signals over the control.

const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"]; // Okabe and Ito's; then the text's
const SIGNALS = ["fx", "fy", "mz"];
const MARGINS = { left: 62, right: 14 }; // of a picture's box

function extremes(values, low = Infinity, high = -Infinity) {
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

/** What the picture of a step shows: all that whiskers and drive pass through in the scan, in tenths of a length. */
function view(reply) {
  const { length, steps } = reply;
  const tenth = 0.1 * length;
  const hanging = 0.8 * tenth * reply.springs.filter(({ between: [first, second] }) => second - first > 1).length;
  const span = (from, to, below, ...columns) => {
    const part = (values) => values.subarray((from * values.length) / steps, (to * values.length) / steps);
    const [low, high] = columns.reduce((range, values) => extremes(part(values), ...range), []);
    return [tenth * Math.floor((low - below) / tenth - 1), tenth * Math.ceil(high / tenth + 1)];
  };
  const all = [
    span(0, steps, 0, reply.line_x, reply.drive_x),
    span(0, steps, hanging, reply.line_y, reply.drive_y),
  ];
  if (all.every(([low, high]) => high - low < 6 * length)) return () => all;
  // Springs give way over many lengths: the picture goes with the whiskers, and the drive is out of it.
  const near = (step) => [span(step, step + 1, 0, reply.line_x), span(step, step + 1, hanging, reply.line_y)];
  return (step) => (Number.isFinite(reply.line_x[step * reply.whiskers * reply.points]) ? near(step) : all);
}

/** A canvas as fine as the screen, emptied. */
function emptied(canvas) {
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

/** A line through points; NaN leaves a gap. */
function line(context, count, x, y, style, width) {
  context.beginPath();
  for (let k = 0, on = false; k < count; k++) {
    const [right, down] = [x(k), y(k)];
    const known = Number.isFinite(right + down);
    if (known) on ? context.lineTo(right, down) : context.moveTo(right, down);
    on = known;
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

function arrow(context, [x0, y0], [x1, y1], style) {
  const angle = Math.atan2(y1 - y0, x1 - x0);
  const back = (reach, turn) => [x1 - reach * Math.cos(angle + turn), y1 - reach * Math.sin(angle + turn)];
  segment(context, [x0, y0, ...back(8, 0)], style, { width: 1.8 });
  context.beginPath();
  for (const corner of [[x1, y1], back(10, 0.4), back(10, -0.4)]) context.lineTo(...corner);
  context.fillStyle = style;
  context.fill();
}

function ticks([low, high], count) {
  const rough = (high - low) / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= 0.999 * rough);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const told = (value) => {
    if (digits <= 4 && Math.max(-low, high) < 1e5) return value.toFixed(digits);
    return value ? Number(value.toPrecision(4)).toExponential() : "0";
  };
  const [first, last] = [Math.ceil(low / step - 1e-9), Math.floor(high / step + 1e-9)];
  return Array.from({ length: last - first + 1 }, (_, k) => [(first + k) * step, told((first + k) * step)]);
}

/** Draw the axes of a box; return where values are on the canvas. */
function axes({ context, width, ink }, { left, right, top, bottom }, x, y, names) {
  const X = (value) => left + ((value - x[0]) / (x[1] - x[0])) * (right - left);
  const Y = (value) => bottom - ((value - y[0]) / (y[1] - y[0])) * (bottom - top);
  const text = (words, x, y, align, baseline) => {
    [context.fillStyle, context.textAlign, context.textBaseline] = [ink, align, baseline];
    const half = align === "center" ? context.measureText(words).width / 2 : 0;
    context.fillText(words, Math.min(x, width - half), y);
  };
  for (const [value, label] of ticks(y, (bottom - top) / 40)) {
    segment(context, [left, Y(value), right, Y(value)], ink, { alpha: 0.12 });
    text(label, left - 6, Y(value), "right", "middle");
  }
  for (const [value, label] of ticks(x, (right - left) / 70)) {
    segment(context, [X(value), top, X(value), bottom], ink, { alpha: 0.12 });
    if (names.x) text(label, X(value), bottom + 5, "center", "top");
  }
  if (names.x) text(names.x, (left + right) / 2, bottom + 21, "center", "top");
  context.save();
  context.translate(left - 48, (top + bottom) / 2);
  context.rotate(-Math.PI / 2);
  text(names.y, 0, 0, "center", "middle");
  context.restore();
  context.globalAlpha = 0.4;
  [context.strokeStyle, context.lineWidth] = [ink, 1];
  context.strokeRect(left, top, right - left, bottom - top);
  context.globalAlpha = 1;
  return { X, Y };
}

function drawScene(canvas, reply, step, failure) {
  const sheet = emptied(canvas);
  const { context, width, height, ink } = sheet;
  const box = { left: MARGINS.left, right: width - MARGINS.right, top: 8, bottom: height - 40 };
  const [[west, east], [south, north]] = reply.shown(step);
  // One scale for both axes; what is left over is shown, too.
  const scale = Math.min((box.right - box.left) / (east - west), (box.bottom - box.top) / (north - south));
  const wider = (box.right - box.left) / scale - (east - west);
  const taller = (box.bottom - box.top) / scale - (north - south);
  const [x, y] = [[west - wider / 2, east + wider / 2], [south - 0.3 * taller, north + 0.7 * taller]];
  const { X, Y } = axes(sheet, box, x, y, reply.labels);
  context.save();
  context.beginPath();
  context.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
  context.clip();

  const around = [(k) => X(reply.outline_x[k]), (k) => Y(reply.outline_y[k])];
  line(context, reply.outline_x.length, ...around, ink, 0.8);
  context.globalAlpha = 0.18;
  context.fillStyle = ink;
  context.fill();
  context.globalAlpha = 0.7;
  for (const { points, rigid } of springs(reply, step)) {
    line(context, points.length, (k) => X(points[k][0]), (k) => Y(points[k][1]), ink, rigid ? 3 : 1.2);
  }
  context.globalAlpha = 1;
  context.fillStyle = ink;
  context.fillRect(X(reply.drive_x[step]) - 4.5, Y(reply.drive_y[step]) - 4.5, 9, 9);
  for (let whisker = 0; whisker < reply.whiskers; whisker++) {
    const [at, style] = [step * reply.whiskers + whisker, colour(whisker, ink)];
    const points = [(k) => X(reply.line_x[at * reply.points + k]), (k) => Y(reply.line_y[at * reply.points + k])];
    line(context, reply.points, ...points, style, 2.5);
    dot(context, X(reply.base_x[at]), Y(reply.base_y[at]), 4, style);
    const share = reply.contact_force[at] / reply.largest;
    if (!(share > 0)) continue;
    const [slope, reach] = [reply.contact_slope[at], (0.1 + 0.25 * share) * reply.length];
    const [tipX, tipY] = [reply.contact_x[at], reply.contact_y[at]];
    const tail = [X(tipX - reach * Math.sin(slope)), Y(tipY + reach * Math.cos(slope))];
    arrow(context, tail, [X(tipX), Y(tipY)], style);
  }
  context.restore();
  if (failure) {
    [context.fillStyle, context.textAlign] = [ink, "center"];
    context.fillText(failure, (box.left + box.right) / 2, box.top + 30);
  }
}

/** Springs along the axes of the drive's frame, as zigzags; torsion springs as spirals. */
function springs(reply, step) {
  const [x, y, turned] = [reply.drive_x[step], reply.drive_y[step], reply.drive_angle[step]];
  const [cos, sin] = [Math.cos(turned), Math.sin(turned)];
  const poses = [[0, 0, 0]];
  for (let at = step * reply.whiskers; at < (step + 1) * reply.whiskers; at++) {
    const [right, up] = [reply.base_x[at] - x, reply.base_y[at] - y];
    poses.push([right * cos + up * sin, up * cos - right * sin, reply.base_angle[at] - turned]);
  }
  let hanging = 0;
  return reply.springs.map((spring) => {
    const [first, second] = spring.between;
    const passing = spring.axis === "x" && Math.abs(second - first) > 1;
    // One that passes other bases hangs below them.
    const level = passing ? reply.lowest - 0.08 * reply.length * ++hanging : undefined;
    const shape = spring.axis === "phi" ? spiral : zigzag;
    const points = shape(poses[first], poses[second], spring, reply.length, level);
    return { rigid: spring.rigid, points: points.map(([a, b]) => [x + cos * a - sin * b, y + sin * a + cos * b]) };
  });
}

function zigzag(here, there, { axis, offset, short, rigid }, unit, level) {
  const along = axis === "x" ? 0 : 1;
  level ??= there[1 - along];
  const swing = 0.018 * unit;
  // One that rests at nearly no length begins at a wall, which moves with the drive.
  const start = here[along] + offset[along] - (short ? 0.16 * unit : 0);
  const wall = [[start, level - 2 * swing], [start, level + 2 * swing], [start, level]];
  const head = short ? wall : [[here[along], here[1 - along]], [here[along], level]];
  // Straight ends and six turns between: the number stays, so that a stretched spring looks stretched.
  const turns = Array.from({ length: 12 }, (_, k) => [0.2 + 0.05 * (k + 0.5), (rigid ? 0 : swing) * (k % 2 ? -1 : 1)]);
  const shares = [[0, 0], [0.2, 0], ...turns, [0.8, 0], [1, 0]];
  const body = shares.map(([share, off]) => [start + share * (there[along] - start), level + off]);
  const points = [...head, ...body, [there[along], there[1 - along]]];
  return along === 0 ? points : points.map(([a, b]) => [b, a]);
}

/** Its inner end turns with the base, its outer end with what holds it. */
function spiral(here, there, { offset, rigid }, unit) {
  const outer = here[2] - Math.PI / 4;
  const wound = rigid ? 0 : there[2] - here[2] - offset[2] - 4.5 * Math.PI;
  const at = (radius, angle) => [there[0] + radius * Math.cos(angle), there[1] + radius * Math.sin(angle)];
  const turns = Array.from({ length: 97 }, (_, k) => at((0.085 * unit * k) / 96, outer + (1 - k / 96) * wound));
  return [...turns, at(0.12 * unit, outer)];
}

function drawSignals(canvas, reply, step) {
  const sheet = emptied(canvas);
  const { context, width, height, ink } = sheet;
  const row = (height - 40) / SIGNALS.length;
  SIGNALS.forEach((name, number) => {
    const [top, bottom] = [8 + number * row, (number + 1) * row - 6];
    const box = { left: MARGINS.left, right: width - MARGINS.right, top, bottom };
    const last = number === SIGNALS.length - 1;
    const names = { x: last && reply.labels.u, y: reply.labels[name] };
    const { X, Y } = axes(sheet, box, reply.range, rounded(extremes(reply[name])), names);
    for (const { control, whiskers, snap } of reply.events) {
      const style = whiskers.length === 1 ? colour(whiskers[0], ink) : ink;
      const look = snap ? { alpha: 0.8, dashes: [4, 4] } : { width: 2 };
      segment(context, [X(control), snap ? top : bottom - 7, X(control), bottom], style, look);
    }
    const here = X(reply.control[step]);
    segment(context, [here, top, here, bottom], ink, { alpha: 0.8 });
    for (let whisker = 0; whisker < reply.whiskers; whisker++) {
      const style = colour(whisker, ink);
      const value = (k) => Y(reply[name][k * reply.whiskers + whisker]);
      line(context, reply.steps, (k) => X(reply.control[k]), value, style, 1.8);
      dot(context, here, value(step), 3.5, style);
    }
  });
}

/** A range that holds another one and does not move with its every digit. */
function rounded([low, high]) {
  if (!(high - low > 1e-9 * Math.abs(high))) return Number.isFinite(low) ? [low - 0.5, low + 0.5] : [-0.5, 0.5];
  const unit = 10 ** Math.floor(Math.log10(high - low)) / 2;
  const room = 0.08 * (high - low);
  return [Math.floor((low - room) / unit) * unit, Math.ceil((high + room) / unit) * unit];
}
