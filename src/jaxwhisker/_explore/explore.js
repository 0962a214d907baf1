// Sliders for a scene: with draw.js before it one module, for Jupyter (anywidget) and for the local page (assets.py).
//
// A host gives `ask(values)`, a promise of one reply (see reply.py), a whole scan: moving the drive asks nobody.

const POSITIONS = 1000; // of a slider
const UNDER_WAY = 2; // requests at a time: one travels while the other is computed
const COMPILING = "Compiling: the first picture of such a scene takes 10 to 30 seconds.";
const ARRAYS = { f8: Float64Array, f4: Float32Array, i1: Int8Array };

// Replies

/** Header and arrays of a reply, and what follows from them for all steps. */
function decoded(reply) {
  // Jupyter hands over a part of a longer buffer.
  const bytes = reply.buffer ? reply.buffer.slice(reply.byteOffset, reply.byteOffset + reply.byteLength) : reply;
  const length = new DataView(bytes).getUint32(0, true);
  const found = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  if (found.error) throw new Error(found.error);
  let at = 4 + length;
  for (const [name, type, shape] of found.arrays) {
    const size = shape.reduce((product, factor) => product * factor, 1);
    found[name] = new ARRAYS[type](bytes, at, size);
    at += found[name].byteLength;
    if (name === "line_x") [found.steps, found.whiskers, found.points] = shape;
  }
  found.range = extremes(found.control);
  found.largest = extremes(found.contact_force)[1];
  found.shown = view(found);
  return found;
}

// The page

function make(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function slider(name, note, heard) {
  const input = make("input", { type: "range", min: 0, max: POSITIONS, name });
  const readout = make("span", { className: "value", ariaHidden: "true" });
  input.addEventListener("input", () => heard(Number(input.value)));
  const tell = (words) => (input.ariaValueText = readout.textContent = words);
  const words = make("span", {}, name.replaceAll("_", " "), note);
  return { input, tell, element: make("label", { className: "slider" }, words, readout, input) };
}

/** The value at a slider's position, with four digits; its ends as they were given. */
function valueAt({ low, high, logarithmic }, position) {
  const share = position / POSITIONS;
  const digits = Math.max(0, 3 - Math.floor(Math.log10(high - low)));
  const exact = logarithmic ? low * (high / low) ** share : low + share * (high - low);
  const value = Number(logarithmic ? exact.toPrecision(4) : exact.toFixed(Math.min(digits, 100)));
  return share === 0 ? low : share === 1 ? high : Math.min(Math.max(value, low), high);
}

function positionOf({ low, high, logarithmic }, value) {
  const share = logarithmic ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  return Math.round(share * POSITIONS);
}

/** A number with six digits at least; zero has no sign. */
function number(value, dimensionless) {
  if (dimensionless) return value.toFixed(6).replace(/^-(0\.0+)$/, "$1");
  return value && Math.abs(value) < 1e-3 ? value.toExponential(6) : value.toPrecision(7);
}

/** Show the sliders in an element; `ask` takes their values to a promise of a reply. Returns how to take them away. */
export function explore(el, { sliders, phases, statuses }, ask) {
  const values = Object.fromEntries(sliders.map(({ name, start }) => [name, start]));
  let reply, step, wished, wanted, due;
  let [asked, answered, waiting, drawn] = [0, 0, 0, 0];

  const title = make("p", { className: "title" });
  const summary = make("p", { className: "summary" });
  const message = make("p", { className: "message", role: "status" });
  const scene = make("canvas", { role: "img" });
  const signals = make("canvas", { role: "img", className: "signals" });
  const pictures = make("div", { className: "pictures" }, scene, signals);
  const drive = slider("drive", "", (position) => moveTo(turned(position)));
  const controls = make("div", { className: "sliders" }, drive.element);
  const heads = ["whisker", "phase", ...SIGNALS, "base x", "contact arc"];
  const head = make("tr", {}, ...heads.map((words) => make("th", { scope: "col" }, words)));
  const rows = make("tbody", {});
  const table = make("div", { className: "table" }, make("table", {}, make("thead", {}, head), rows));
  const events = make("ol", { ariaLabel: "events of the scan" });
  const numbers = make("div", { className: "numbers" }, table, events);
  const show = make("button", { type: "button", ariaExpanded: "false" }, "Python code");
  const copy = make("button", { type: "button", hidden: true }, "copy");
  const code = make("pre", { hidden: true, tabIndex: 0, ariaLabel: "Python code of the scene" });
  const parts = [title, summary, message, pictures, controls, numbers, show, copy, code];
  const root = make("div", { className: "jaxwhisker", ariaBusy: "true" }, ...parts);
  el.replaceChildren(root);

  for (const one of sliders) {
    const { input, tell, element } = slider(one.name, one.logarithmic ? " (log)" : "", (position) => {
      values[one.name] = valueAt(one, position);
      tell(`${values[one.name]}`);
      refresh();
    });
    input.value = positionOf(one, one.start);
    tell(`${one.start}`);
    controls.append(element);
  }

  /** The slider runs along u, whichever way the scan goes. */
  function turned(position) {
    return reply && reply.control[0] > reply.control[reply.steps - 1] ? reply.steps - 1 - position : position;
  }

  function nearest(u) {
    const away = (k) => Math.abs(reply.control[k] - u);
    return reply.control.reduce((best, _, k) => (away(k) < away(best) ? k : best), 0);
  }

  function moveTo(next) {
    if (!reply) return;
    [step, wished] = [next, reply.control[next]];
    draw();
  }

  /** Ask for the current values, as soon as not too many requests are under way. */
  function refresh() {
    wanted = waiting === UNDER_WAY;
    if (!wanted) request(++asked);
  }

  async function request(number) {
    waiting++;
    root.ariaBusy = "true";
    const told = () => number > answered && say(reply ? "Computing ..." : COMPILING);
    const slow = setTimeout(told, reply ? 1000 : 0);
    let found, wrong;
    try {
      found = decoded(await ask({ ...values }));
    } catch (error) {
      wrong = error.message;
    }
    clearTimeout(slow);
    waiting--;
    if (number > answered) {
      // Replies may overtake each other; the latest values win.
      answered = number;
      if (found) take(found);
      say(wrong ?? "", Boolean(wrong));
    }
    if (wanted) refresh();
    draw();
  }

  function take(next) {
    reply = next;
    wished ??= (reply.range[0] + reply.range[1]) / 2;
    step = nearest(wished);
    drive.input.max = reply.steps - 1;
    title.textContent = scene.ariaLabel = reply.title;
    signals.ariaLabel = `${SIGNALS.join(", ")} of all whiskers over the drive's position`;
    summary.textContent = reply.summary;
    summary.classList.toggle("wrong", reply.failed > 0);
    const told = reply.events.length ? reply.events : [{ text: "no events" }];
    events.replaceChildren(...told.map(({ text }) => make("li", {}, text)));
    if (rows.childElementCount === reply.whiskers) return;
    rows.replaceChildren(
      ...Array.from({ length: reply.whiskers }, (_, k) => {
        const name = make("th", { scope: "row" }, `${k + 1}`);
        name.style.setProperty("--colour", colour(k, "currentColor"));
        return make("tr", {}, name, ...heads.slice(1).map(() => make("td", {})));
      }),
    );
  }

  function say(words, wrong = false) {
    if (message.textContent !== words) message.textContent = words;
    root.classList.toggle("refused", wrong);
  }

  function draw() {
    due ??= requestAnimationFrame(() => {
      due = undefined;
      if (reply) {
        const failure = reply.status[step] ? `no state here: ${statuses[reply.status[step]]}` : "";
        drawScene(scene, reply, step, failure);
        drawSignals(signals, reply, step);
        write(failure);
        root.dataset.drawn = ++drawn;
      }
      root.ariaBusy = `${waiting > 0}`;
    });
  }

  /** Write the numbers at the drive's position. */
  function write(failure) {
    const told = (value) => number(value, reply.dimensionless);
    drive.input.value = turned(step);
    drive.tell(`u = ${told(reply.control[step])}`);
    [...rows.children].forEach((row, whisker) => {
      const at = step * reply.whiskers + whisker;
      const found = [...SIGNALS, "base_x", "contact_arc"].map((name) => (failure ? "" : told(reply[name][at])));
      const cells = [failure ? "unknown" : phases[reply.phase[at]], ...found];
      cells.forEach((words, k) => (row.children[k + 1].textContent = words));
    });
    if (!code.hidden) code.textContent = reply.code.join(step);
  }

  const follow = ({ offsetX }) => {
    if (!reply) return;
    const share = (offsetX - MARGINS.left) / (signals.clientWidth - MARGINS.left - MARGINS.right);
    moveTo(nearest(reply.range[0] + share * (reply.range[1] - reply.range[0])));
  };
  signals.addEventListener("pointerdown", (event) => {
    signals.setPointerCapture(event.pointerId);
    follow(event);
  });
  signals.addEventListener("pointermove", (event) => event.buttons && follow(event));
  show.addEventListener("click", () => {
    code.hidden = copy.hidden = !code.hidden;
    show.ariaExpanded = `${!code.hidden}`;
    draw();
  });
  copy.addEventListener("click", async () => {
    getSelection().selectAllChildren(code);
    await navigator.clipboard?.writeText(code.textContent); // elsewhere the text is marked at least
  });
  const resized = new ResizeObserver(draw);
  for (const canvas of [scene, signals]) resized.observe(canvas);
  const themed = new MutationObserver(draw); // JupyterLab's light and dark
  themed.observe(document.body, { attributes: true });
  const dark = matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", draw);
  refresh();
  return () => {
    resized.disconnect();
    themed.disconnect();
    dark.removeEventListener("change", draw);
  };
}

// Jupyter

/** What anywidget calls: the kernel is asked by messages, which tell by number what they reply to. */
function render({ model, el }) {
  const waiting = new Map();
  const heard = ({ id, error }, buffers) => {
    const settle = waiting.get(id); // unknown where another view of the widget has asked
    waiting.delete(id);
    if (error) settle?.reject(new Error(error));
    else settle?.resolve(buffers[0]);
  };
  model.on("msg:custom", heard);
  const ask = (values) =>
    new Promise((resolve, reject) => {
      const id = `${Math.random()}`;
      waiting.set(id, { resolve, reject });
      model.send({ id, values });
    });
  const remove = explore(el, model.get("description"), ask);
  return () => {
    model.off("msg:custom", heard);
    remove();
  };
}

export default { render };

// The local page

async function fetched(...request) {
  const response = await fetch(...request).catch(() => {
    throw new Error("No answer: the command that serves this page has ended.");
  });
  if (!response.ok) throw new Error(await response.text());
  return response;
}

async function open() {
  const headers = { "Content-Type": "application/json" };
  const ask = async (values) =>
    (await fetched("scan", { method: "POST", headers, body: JSON.stringify(values) })).arrayBuffer();
  explore(document.body, await (await fetched("sliders")).json(), ask);
}

if (document.body.classList.contains("jaxwhisker-page")) open();
