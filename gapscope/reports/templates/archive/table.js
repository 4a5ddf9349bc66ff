/* Shows the rows of the page that hold all words typed. */
"use strict";

(() => {
  const input = document.getElementById("filter");
  if (!input) return;
  const rows = [...document.querySelectorAll(".archive tbody tr")];
  const texts = rows.map((row) => row.textContent.toLowerCase());
  const apply = () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    rows.forEach((row, k) => { row.hidden = !words.every((word) => texts[k].includes(word)); });
    const left = rows.filter((row) => !row.hidden).length;
    document.getElementById("shown").textContent = words.length ? `${left} of the ${rows.length} rows on this page` : "";
  };
  input.addEventListener("input", apply);
  apply(); // what was typed is kept on reload by some browsers
})();
