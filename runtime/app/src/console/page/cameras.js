// Camera views: a picture each, and what of it is shown.

const PLANES = ["colour", "depth", "ids"];

/** Of so many pictures of a camera the run is told of one that it is shown. */
const SHOWN_EVERY = 5;
/** Longer than any display takes to its next frame, ms. */
const FRAME_MS = 250;

export class Cameras {
  #views = [];
  #send;
  #others;
  #also = [];
  #elsewhere = false;

  /** `others` says which streams are wanted besides. */
  constructor(send, others) {
    this.#send = send;
    this.#others = others;
    this.root = document.getElementById("views");
    this.none = document.getElementById("no-cameras");
  }

  /** Shows `names`; what was recorded has colour alone, but for those `deep`, some of which are `drawn` on demand. */
  set(names, recorded, deep, drawn) {
    const same = names.length === this.#views.length && names.every((name, i) => this.#views[i].name === name);
    if (!same) {
      this.root.replaceChildren();
      this.#views = names.map((name, index) => this.#view(name, index, recorded && !drawn.includes(name), deep.includes(name)));
    }
    this.root.classList.toggle("many", names.length > 2);
    this.none.hidden = names.length > 0;
    this.none.textContent = "This run has no camera here.";
    this.want();
  }

  want() {
    const wanted = this.#views.map((view, index) => [index, this.#plane(index)]).filter(([, plane]) => plane !== "off");
    this.#send({ show: [...wanted, ...this.#others()] });
  }

  /** Pictures of these cameras are wanted too, though they are not shown. */
  also(cameras) {
    this.#also = cameras;
    this.want();
  }

  /** Whether the person looks at the pictures elsewhere, in a headset, whose frames say by `uploaded` what they show. */
  elsewhere(on) {
    this.#elsewhere = on;
  }

  /** The picture that `image` has now is in the headset's frame that is being drawn. */
  uploaded(image) {
    const camera = this.#views.findIndex((view) => view.image === image);
    const view = this.#views[camera];
    if (!view || image.src !== view.url) return;
    view.uploads += 1;
    if (view.uploads % SHOWN_EVERY === 0) this.#send({ shown: [camera, view.seconds] });
  }

  /** The element with the newest picture of a camera, if there is such a camera. */
  image(camera) {
    return this.#views[camera]?.image;
  }

  #plane(camera) {
    const { plane } = this.#views[camera];
    return plane === "off" && this.#also.includes(camera) ? "colour" : plane;
  }

  async picture(camera, plane, seconds, blob) {
    const view = this.#views[camera];
    if (!view || PLANES[plane] !== this.#plane(camera)) return;
    // While one is decoded only the newest waits.
    view.next = { seconds, blob };
    if (view.busy) return;
    view.busy = true;
    while (view.next) {
      const next = view.next;
      view.next = null;
      await this.#draw(view, next);
    }
    view.busy = false;
  }

  async #draw(view, { seconds, blob }) {
    const before = view.url;
    view.url = URL.createObjectURL(blob);
    view.seconds = seconds;
    view.image.src = view.url;
    try {
      await view.image.decode();
    } catch {
      // A picture that can't be shown is replaced by the next.
    }
    view.image.alt = `${view.name}, ${view.plane}, at ${seconds.toFixed(2)} s`;
    view.image.dataset.seconds = seconds.toFixed(3);
    view.count += 1;
    view.total += 1;
    if (view.total % SHOWN_EVERY === 0) this.#shown(view, seconds);
    if (before) URL.revokeObjectURL(before);
  }

  /**
   * Tells the run that the picture of `seconds` is shown: its browser draws it in the frame that begins next. Where no frames begin (a hidden
   * page) nothing is told, then or later; of what is looked at in a headset its own frames tell.
   */
  #shown(view, seconds) {
    if (view.awaited || this.#elsewhere) return;
    view.awaited = true;
    const asked = performance.now();
    requestAnimationFrame(() => {
      view.awaited = false;
      const camera = this.#views.indexOf(view);
      if (camera >= 0 && !this.#elsewhere && performance.now() - asked < FRAME_MS) this.#send({ shown: [camera, seconds] });
    });
  }

  /** Tells how many pictures came since the last call, `elapsed` seconds ago. */
  rates(elapsed) {
    for (const view of this.#views) {
      const rate = view.plane === "off" ? "" : `${Math.round(view.count / elapsed)}/s`;
      if (view.rate.textContent !== rate) view.rate.textContent = rate;
      view.count = 0;
    }
  }

  /** Where the chunks lead, into the pictures; `shown` or not. */
  paths(paths, shown) {
    this.#views.forEach((view, index) => {
      const { naturalWidth: width, naturalHeight: height } = view.image;
      const lines = shown && view.plane !== "off" ? paths.map((path) => path.pictures[index] ?? []) : [];
      view.path.setAttribute("viewBox", `0 0 ${Math.max(1, width)} ${Math.max(1, height)}`);
      [...view.path.children].forEach((line, place) => {
        const points = lines[Math.floor(place / 2)] ?? [];
        line.setAttribute("points", points.map(([x, y]) => `${(x * width).toFixed(1)},${(y * height).toFixed(1)}`).join(" "));
      });
    });
  }

  #view(name, index, recorded, deep) {
    const figure = document.createElement("figure");
    figure.className = "view";
    const image = document.createElement("img");
    image.alt = `${name}, no picture yet`;
    image.src = "data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw==";
    const caption = document.createElement("figcaption");
    const title = document.createElement("strong");
    title.textContent = name;
    const select = document.createElement("select");
    select.setAttribute("aria-label", `What of ${name} is shown`);
    const colourOnly = recorded && !deep;
    const planes = colourOnly ? ["colour"] : recorded ? PLANES : [...PLANES, "off"];
    for (const plane of planes) select.add(new Option(plane, plane));
    // A software renderer has its limits: the first camera is shown, the others by choice.
    const plane = recorded || index === 0 ? "colour" : "off";
    select.value = plane;
    select.hidden = colourOnly;
    const rate = document.createElement("span");
    rate.className = "rate";
    caption.append(title, rate, select);
    const path = document.getElementById("path").content.firstElementChild.cloneNode(true);
    const frame = document.createElement("div");
    frame.className = "frame";
    frame.append(image, path);
    figure.append(frame, caption);
    this.root.append(figure);
    const view = { name, image, path, select, rate, plane, count: 0, total: 0, uploads: 0, url: null, seconds: 0, next: null, busy: false };
    frame.hidden = plane === "off";
    select.onchange = () => {
      view.plane = select.value;
      frame.hidden = view.plane === "off";
      this.want();
    };
    return view;
  }
}
