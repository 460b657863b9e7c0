"use strict";
// A click on a column's head sorts the table by it, and a second click the other way; empty cells come last.
for (const table of document.querySelectorAll("table.sorted")) {
  const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const values = [...body.rows].map((row) => row.cells[column].dataset.value).filter((value) => value !== "");
    const numbers = values.length > 0 && values.every((value) => isFinite(value));
    head.classList.toggle("number", numbers);
    head.firstElementChild.addEventListener("click", () => {
      const falling = head.getAttribute("aria-sort") === "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", falling ? "descending" : "ascending");
      const sorted = [...body.rows].sort((first, second) => {
        const [a, b] = [first, second].map((row) => row.cells[column].dataset.value);
        if (a === "" || b === "") return (a === "") - (b === "");
        return (falling ? -1 : 1) * (numbers ? a - b : a.localeCompare(b));
      });
      body.append(...sorted);
    });
  });
}
addEventListener("beforeprint", () => {
  for (const details of document.querySelectorAll("details")) details.open = true;
});
