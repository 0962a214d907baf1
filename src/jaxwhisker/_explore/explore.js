// Sliders for a scene. Together with draw.js and space.js, this is a single module for Jupyter (anywidget) and for the local page.
//
// A host provides `ask(values)`, which returns a promise of a picture (see picture.py). A picture is a whole scan or
// motion, so moving the drive, or the time, needs no request.

const POSITIONS = 1000; // of a slider
const MOST_REQUESTS = 2; // at a time: one is on its way while the other is computed
const PLAYED = 8000; // milliseconds in which a whole motion is played
const IMPACTS = 0.02; // share of the states in contact of a motion that may be impacts, whose arrows are not longer
const NOISE = 1e-6; // of the least height of the axis of a signal in space: smaller numbers are shown as zero
const COMPILING = "Compiling. The first picture of such a scene takes some seconds, in space up to a minute.";
const ARRAYS = { f8: Float64Array, f4: Float32Array, i4: Int32Array, i1: Int8Array };

/** Header and arrays of a picture, and values for drawing that are the same at all steps. */
function unpacked(packed) {
  // Jupyter's buffer is part of a longer one.
  const bytes = packed.buffer ? packed.buffer.slice(packed.byteOffset, packed.byteOffset + packed.byteLength) : packed;
  const length = new DataView(bytes).getUint32(0, true);
  const picture = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  if (picture.error) throw new Error(picture.error);
  let at = 4 + length;
  for (const [name, type, shape] of picture.arrays) {
    const size = shape.reduce((product, factor) => product * factor, 1);
    picture[name] = new ARRAYS[type](bytes, at, size);
    at += picture[name].byteLength;
    if (name === "line_x" || name === "line") [picture.steps, picture.whiskers, picture.points] = shape;
  }
  const [[symbol, along]] = picture.places;
  picture.symbol = symbol;
  picture.along = picture[along]; // the control of a scan, the time of a motion
  picture.range = extremes(picture.along);
  const forces = picture.contact_force.filter((force) => force > 0).sort();
  picture.largestForce = forces[Math.floor((forces.length - 1) * (symbol === "t" ? 1 - IMPACTS : 1))];
  if (!picture.window) picture.viewAt = viewOf(picture); // in the plane
  return picture;
}

function make(tag, properties, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** A labelled slider; `setText` shows its value. */
function slider(name, note, onInput) {
  const input = make("input", { type: "range", min: 0, max: POSITIONS, name });
  const readout = make("span", { className: "value", ariaHidden: "true" });
  input.addEventListener("input", () => onInput(Number(input.value)));
  const setText = (text) => (input.ariaValueText = readout.textContent = text);
  const label = make("span", {}, name.replaceAll("_", " "), note);
  return { input, setText, element: make("label", { className: "slider" }, label, readout, input) };
}

/** The value at a position of a slider, rounded to four digits except at the ends. */
function valueAt({ low, high, logarithmic }, position) {
  const share = position / POSITIONS;
  const digits = Math.max(0, 3 - Math.floor(Math.log10(high - low)));
  const exact = logarithmic ? low * (high / low) ** share : low + share * (high - low);
  const value = Number(logarithmic ? exact.toPrecision(4) : exact.toFixed(Math.min(digits, 100)));
  return share === 0 ? low : share === 1 ? high : Math.min(Math.max(value, low), high);
}

/** A value of a parameter in the unit in which it is shown. */
function withUnit({ unit }, value) {
  return `${Number((value / unit.size).toPrecision(12))} ${unit.name}`.trim();
}

function positionOf({ low, high, logarithmic }, value) {
  const share = logarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  return Math.round(share * POSITIONS);
}

/** A number as text with at least six digits; zero has no sign. */
function format(value, dimensionless) {
  if (dimensionless) return value.toFixed(6).replace(/^-(0\.0+)$/, "$1");
  return value && Math.abs(value) < 1e-3 ? value.toExponential(6) : value.toPrecision(7);
}

/** Show the sliders in an element; returns a function that removes them. */
export function explore(el, { sliders, position, views, phases, statuses }, ask) {
  const values = Object.fromEntries(sliders.map(({ name, start }) => [name, start]));
  let angles = views.camera; // of the camera in space
  let picture, step, wished, outdated, nextFrame, playing;
  let [sent, latest, waiting, drawn] = [0, 0, 0, 0]; // numbers of requests; the answer to `latest` is shown

  const title = make("p", { className: "title" });
  const summary = make("p", { className: "summary" });
  const message = make("p", { className: "message", role: "status" });
  const scene = make("canvas", { role: "img" });
  const signals = make("canvas", { role: "img", className: "signals" });
  const canvases = make("div", { className: "pictures" }, scene, signals);
  const place = slider(position, "", (at) => {
    pause();
    moveTo(reversed(at));
  });
  const controls = make("div", { className: "sliders" }, place.element);
  const play = make("button", { type: "button", hidden: position !== "time" }, "play");
  const head = make("tr", {});
  const rows = make("tbody", {});
  const table = make("div", { className: "table" }, make("table", {}, make("thead", {}, head), rows));
  const events = make("ol", { ariaLabel: "events" });
  const numbers = make("div", { className: "numbers" }, table, events);
  const show = make("button", { type: "button", ariaExpanded: "false" }, "Python code");
  const copy = make("button", { type: "button", hidden: true }, "copy");
  const code = make("pre", { hidden: true, tabIndex: 0, ariaLabel: "Python code of the scene" });
  const looks = Object.entries(views).map(([name, from]) => {
    const button = make("button", { type: "button" }, name);
    button.addEventListener("click", () => look(from));
    return button;
  });
  const camera = make("div", { role: "group", ariaLabel: "view", hidden: !looks.length }, ...looks);
  const top = make("div", { className: "top" }, title, summary, message, canvases, camera, play, controls);
  const parts = [top, numbers, show, copy, code];
  const className = looks.length ? "jaxwhisker space" : "jaxwhisker";
  const root = make("div", { className, ariaBusy: "true" }, ...parts);
  el.replaceChildren(root);

  for (const range of sliders) {
    const { input, setText, element } = slider(range.name, range.logarithmic ? " (log)" : "", (position) => {
      values[range.name] = valueAt(range, position);
      setText(withUnit(range, values[range.name]));
      refresh();
    });
    input.value = positionOf(range, range.start);
    setText(withUnit(range, range.start));
    controls.append(element);
  }

  /** Convert the position of the first slider to a step, or back: the slider runs along u, the scan either way. */
  function reversed(at) {
    return picture && picture.along[0] > picture.along[picture.steps - 1] ? picture.steps - 1 - at : at;
  }

  function nearestStep(value) {
    const distance = (k) => Math.abs(picture.along[k] - value);
    return picture.along.reduce((best, _, k) => (distance(k) < distance(best) ? k : best), 0);
  }

  function moveTo(nextStep) {
    if (!picture) return;
    [step, wished] = [nextStep, picture.along[nextStep]];
    draw();
  }

  /** Play a motion to its end, from the start if it is at its end. */
  function run() {
    play.textContent = "pause";
    let before;
    let exact = step === picture.steps - 1 ? 0 : step;
    const advance = (now) => {
      const last = picture.steps - 1;
      exact = Math.min(exact + (last * (now - (before ?? now))) / PLAYED, last);
      before = now;
      moveTo(Math.floor(exact));
      if (exact < last) playing = requestAnimationFrame(advance);
      else pause();
    };
    playing = requestAnimationFrame(advance);
  }

  function pause() {
    cancelAnimationFrame(playing);
    playing = undefined;
    play.textContent = "play";
  }

  /** Ask for the current values, now or when a request has been answered. */
  function refresh() {
    outdated = waiting === MOST_REQUESTS;
    if (!outdated) request(++sent);
  }

  async function request(number) {
    waiting++;
    root.ariaBusy = "true";
    const explain = () => number > latest && say(picture ? "Computing ..." : COMPILING);
    const slow = setTimeout(explain, picture ? 1000 : 0);
    let next, error;
    try {
      next = unpacked(await ask({ ...values }));
    } catch ({ message }) {
      error = message;
    }
    clearTimeout(slow);
    waiting--;
    if (number > latest) {
      // Answers may arrive out of order; only the latest values count.
      latest = number;
      if (next) take(next);
      say(error ?? next.note, Boolean(error));
    }
    if (outdated) refresh();
    draw();
  }

  function take(next) {
    picture = next;
    wished ??= (picture.range[0] + picture.range[1]) / 2;
    step = nearestStep(wished);
    place.input.max = picture.steps - 1;
    title.textContent = scene.ariaLabel = picture.title;
    signals.ariaLabel = `${picture.signals.join(", ")} of all whiskers over the ${position === "time" ? "time" : "drive's position"}`;
    summary.textContent = picture.summary;
    summary.classList.toggle("wrong", picture.failed > 0);
    const texts = picture.events.length ? picture.events.map(({ text }) => text) : ["no events"];
    events.replaceChildren(...texts.map((text) => make("li", {}, text)));
    const headings = ["whisker", "phase", ...picture.columns.map(([, heading]) => heading)];
    head.replaceChildren(...headings.map((text) => make("th", { scope: "col" }, text)));
    rows.replaceChildren(...Array.from({ length: picture.whiskers }, (_, k) => row(k, headings.length - 1)));
  }

  function row(whisker, cells) {
    const name = make("th", { scope: "row" }, `${whisker + 1}`);
    name.style.setProperty("--colour", colour(whisker, "currentColor"));
    return make("tr", {}, name, ...Array.from({ length: cells }, () => make("td", {})));
  }

  function say(text, wrong = false) {
    if (message.textContent !== text) message.textContent = text;
    root.classList.toggle("refused", wrong);
  }

  /** Look at a scene in space from a camera. */
  function look(from) {
    angles = from;
    draw();
  }

  function draw() {
    nextFrame ??= requestAnimationFrame(() => {
      nextFrame = undefined;
      if (picture) {
        const failure = picture.status[step] ? `no state here: ${statuses[picture.status[step]]}` : "";
        (angles ? drawSpace : drawScene)(scene, picture, step, failure, angles);
        drawSignals(signals, picture, step);
        write(failure);
        root.dataset.drawn = ++drawn;
      }
      root.ariaBusy = `${waiting > 0}`;
    });
  }

  /** Write the numbers at this step. */
  function write(failure) {
    const text = (value) => format(value, picture.dimensionless);
    place.input.value = reversed(step);
    const read = ([symbol, name, unit]) => `${symbol} = ${text(picture[name][step])}${unit}`;
    place.setText(picture.places.map(read).join(", "));
    [...rows.children].forEach(({ children }, whisker) => {
      const at = step * picture.whiskers + whisker;
      const touching = contactsAt(picture, at);
      const places = (name) => (picture[name].length === picture.phase.length ? touching : [at]);
      const exact = (name, k) => (Math.abs(picture[name][k]) < NOISE * picture.least?.[name] ? 0 : picture[name][k]);
      const words = (name) => places(name).map((k) => text(exact(name, k))).join(", ");
      const known = picture.columns.map(([name]) => (failure ? "" : words(name)));
      const cells = [failure ? "unknown" : touching.map((k) => phases[picture.phase[k]]).join(", "), ...known];
      cells.forEach((cell, k) => (children[k + 1].textContent = cell));
    });
    if (!code.hidden) code.textContent = picture.code.join(step);
  }

  const follow = ({ offsetX }) => {
    if (!picture) return;
    const share = (offsetX - MARGINS.left) / (signals.clientWidth - MARGINS.left - MARGINS.right);
    pause();
    moveTo(nearestStep(picture.range[0] + share * (picture.range[1] - picture.range[0])));
  };
  signals.addEventListener("pointerdown", (event) => {
    signals.setPointerCapture(event.pointerId);
    follow(event);
  });
  signals.addEventListener("pointermove", (event) => event.buttons && follow(event));
  scene.addEventListener("pointerdown", ({ pointerId }) => angles && scene.setPointerCapture(pointerId));
  scene.addEventListener("pointermove", ({ buttons, movementX, movementY }) => {
    if (angles && buttons) look(turned(angles, movementX, movementY));
  });
  play.addEventListener("click", () => picture && (playing ? pause() : run()));
  show.addEventListener("click", () => {
    code.hidden = copy.hidden = !code.hidden;
    show.ariaExpanded = `${!code.hidden}`;
    draw();
  });
  copy.addEventListener("click", async () => {
    getSelection().selectAllChildren(code); // for browsers without access to the clipboard
    await navigator.clipboard?.writeText(code.textContent);
  });
  const resized = new ResizeObserver(draw);
  for (const canvas of [scene, signals]) resized.observe(canvas);
  const themed = new MutationObserver(draw); // JupyterLab switches between light and dark
  themed.observe(document.body, { attributes: true });
  const dark = matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", draw);
  refresh();
  return () => {
    pause();
    resized.disconnect();
    themed.disconnect();
    dark.removeEventListener("change", draw);
  };
}

/** Entry point in Jupyter, which anywidget calls. Answers of the kernel carry the id of their request. */
function render({ model, el }) {
  const waiting = new Map();
  const onAnswer = ({ id, error }, buffers) => {
    const promise = waiting.get(id); // undefined if another view of the widget sent the request
    waiting.delete(id);
    if (error) promise?.reject(new Error(error));
    else promise?.resolve(buffers[0]);
  };
  model.on("msg:custom", onAnswer);
  const ask = (values) =>
    new Promise((resolve, reject) => {
      const id = `${Math.random()}`;
      waiting.set(id, { resolve, reject });
      model.send({ id, values });
    });
  const remove = explore(el, model.get("description"), ask);
  return () => {
    model.off("msg:custom", onAnswer);
    remove();
  };
}

export default { render };

/** Entry point of the local page. */
async function open() {
  const fetched = async (...request) => {
    const response = await fetch(...request).catch(() => {
      throw new Error("No answer: the command that serves this page has ended.");
    });
    if (!response.ok) throw new Error(await response.text());
    return response;
  };
  const headers = { "Content-Type": "application/json" };
  const ask = async (values) =>
    (await fetched("scan", { method: "POST", headers, body: JSON.stringify(values) })).arrayBuffer();
  explore(document.body, await (await fetched("sliders")).json(), ask);
}

if (document.body.classList.contains("jaxwhisker-page")) open();
