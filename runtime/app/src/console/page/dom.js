// What all parts of the page do with its elements.

export const byId = (id) => document.getElementById(id);

export function element(tag, className, text) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

export function text(node, value) {
  if (node.textContent !== value) node.textContent = value;
}

/** Whether an element takes letters itself: a text, or a list to choose from by them. A slider takes none. */
export const takesLetters = ({ tagName, type }) => tagName === "SELECT" || (tagName === "INPUT" && type === "text");
