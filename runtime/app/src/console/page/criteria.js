// What a task's success asks for, as it stands: a row each.

import { byId, element, text } from "./dom.js";

const millimetres = (value) => `${(value * 1000).toFixed(1)} mm`;
const WORDS = {
  m: millimetres,
  "m/s": (value) => `${millimetres(value)}/s`,
  rad: (value) => `${((value * 180) / Math.PI).toFixed(1)}°`,
  N: (value) => `${value.toFixed(2)} N`,
  s: (value) => `${value.toFixed(2)} s`,
  "": (value) => (value ? "yes" : "no"),
};

/** Shows `criteria`; a value that is not known is null. */
export function showCriteria(criteria) {
  byId("criteria").hidden = criteria.length === 0;
  const rows = byId("criteria-rows");
  while (rows.children.length > criteria.length) rows.lastChild.remove();
  criteria.forEach(({ name, unit, value, goal, at_least: least, met }, index) => {
    const row = rows.children[index] ?? rows.appendChild(newRow());
    const words = WORDS[unit];
    const bound = unit === "" ? "yes" : `${least ? "≥" : "≤"} ${words(goal)}`;
    const cells = [name, value === null ? "–" : words(value), bound, met ? "met" : "open"];
    cells.forEach((cell, place) => text(row.children[place], cell));
    row.dataset.met = String(met);
  });
}

function newRow() {
  const row = element("tr");
  const name = row.appendChild(element("th"));
  name.scope = "row";
  for (let cell = 0; cell < 3; cell += 1) row.append(element("td"));
  return row;
}
