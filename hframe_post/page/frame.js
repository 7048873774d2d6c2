"use strict";
const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);

function make(tag, text, kind) {  // text from a file is never parsed as markup
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (kind) made.className = kind;
  return made;
}
function add(parent, ...children) { parent.append(...children); return parent; }
function card(what, value, unit, more, kind) {
  add($("cards"), add(make("div", undefined, `card ${kind}`), make("p", what, "what"),
    add(make("p", value, "value"), make("small", unit ? ` ${unit}` : "")), make("p", more, "more")));
}

document.title = `${data.name} – hframe-post`;
$("name").textContent = data.name.replace(/[_-]/g, "$&\u200b");  // where it may wrap
$("version").textContent = data.version;
for (const text of data.warnings) add($("warnings"), make("p", text));
for (const note of data.notes) {
  const [, label, text] = /^(\S.{0,15}?)\s{2,}(.*)$/.exec(note) || [null, "", note];
  add($("notes"), add(make("li"), make("span", label), make("span", text)));
}
for (const [label, text] of data.facts) add($("facts"), make("dt", label), make("dd", text));

