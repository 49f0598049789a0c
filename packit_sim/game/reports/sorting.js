// Tables sorted by a click on a heading, and the choice of the agent that others are compared with.
"use strict";
(() => {
  const key = (row, column) => {
    const value = row.cells[column].dataset.value;
    return value === "" ? null : Number.isNaN(Number(value)) ? value : Number(value);
  };
  const compare = (a, b) => (typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b)));

  for (const table of document.querySelectorAll("table.sortable")) {
    const headings = [...table.tHead.rows[0].cells];
    headings.forEach((heading, column) => {
      heading.firstElementChild.addEventListener("click", () => {
        const rows = [...table.tBodies[0].rows];
        const numbers = rows.some((row) => typeof key(row, column) === "number");
        const before = heading.getAttribute("aria-sort");
        const down = before ? before === "ascending" : numbers;
        headings.forEach((other) => other.removeAttribute("aria-sort"));
        heading.setAttribute("aria-sort", down ? "descending" : "ascending");
        rows.sort((one, other) => {
          const [a, b] = [key(one, column), key(other, column)];
          if (a === null || b === null) return (a === null) - (b === null);
          return down ? compare(b, a) : compare(a, b);
        });
        table.tBodies[0].append(...rows);
      });
    });
  }

  const against = document.getElementById("against");
  if (against) {
    const tables = [...document.querySelectorAll(".against")];
    const show = () => tables.forEach((table, n) => (table.hidden = n !== Number(against.value)));
    against.addEventListener("change", show);
    show();
  }
})();
