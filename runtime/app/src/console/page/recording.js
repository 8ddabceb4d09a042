// How far a recording by the expert is.

import { byId } from "./dom.js";

export class Recording {
  show({ kept, wanted, attempts, newest }) {
    const bar = byId("recorded");
    bar.max = wanted;
    bar.value = kept;
    byId("recorded-text").textContent = `${kept} of ${wanted} episodes kept; attempts in this recording: ${attempts}.`;
    const lines = newest.map(({ seed, kept: good, reason, steps }) => {
      const line = document.createElement("li");
      line.dataset.kept = String(good);
      line.textContent = good ? `seed ${seed}: kept, ${steps} steps` : `seed ${seed}: not kept: ${reason}`;
      return line;
    });
    byId("attempts").replaceChildren(...lines.reverse());
  }
}
