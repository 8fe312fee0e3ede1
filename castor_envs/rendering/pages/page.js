// Tables that sort and filter, and maps that zoom. Without it, pages are whole but stand still.
"use strict";

for (const table of document.querySelectorAll("table[data-sortable]")) {
  const body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    if (head.dataset.fixed !== undefined) return;
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const keyed = [...body.rows].map((row) => {
        const cell = row.cells[column];
        const text = cell.dataset.sort ?? cell.textContent.trim();
        const number = text === "" ? NaN : Number(text);
        return { row, text, number, blank: text === "" || text === "–" };
      });
      const numeric = keyed.every((one) => one.blank || !Number.isNaN(one.number));
      keyed.sort((a, b) => {
        if (a.blank !== b.blank) return a.blank ? 1 : -1; // blanks last, either way
        const order = numeric ? a.number - b.number : a.text.localeCompare(b.text, "en", { numeric: true });
        return down ? -order : order;
      });
      body.append(...keyed.map((one) => one.row));
    });
  });
}

for (const form of document.querySelectorAll(".filter")) {
  form.hidden = false;
  const input = form.querySelector("input");
  const said = form.querySelector("output");
  const rows = [...document.querySelectorAll(form.dataset.of)].flatMap((table) => [...table.tBodies[0].rows]);
  const apply = () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
      shown += !row.hidden;
    }
    said.textContent = words.length ? `${shown} of ${rows.length} rows` : "";
  };
  input.addEventListener("input", apply);
  apply();
}

for (const map of document.querySelectorAll("svg.map")) {
  const whole = map.getAttribute("viewBox");
  const box = () => map.getAttribute("viewBox").split(" ").map(Number);
  const zoom = (factor, px = 0.5, py = 0.5) => {
    const [x, y, w, h] = box();
    const size = Number(whole.split(" ")[2]);
    const to = Math.min(Math.max(w * factor, size / 200), size);
    const share = to / w;
    if (to === size) map.setAttribute("viewBox", whole);
    else map.setAttribute("viewBox", [x + px * w * (1 - share), y + py * h * (1 - share), to, h * share].join(" "));
  };
  const place = (event) => {
    const frame = map.getBoundingClientRect();
    return [(event.clientX - frame.left) / frame.width, (event.clientY - frame.top) / frame.height];
  };
  map.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== map) return; // the page scrolls, unless the map is chosen
    event.preventDefault();
    zoom(event.deltaY > 0 ? 1.25 : 0.8, ...place(event));
  }, { passive: false });
  map.addEventListener("dblclick", () => map.setAttribute("viewBox", whole));
  let held = null;
  map.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "touch") return;
    held = { at: place(event), box: box() };
    map.setPointerCapture(event.pointerId);
  });
  map.addEventListener("pointermove", (event) => {
    if (!held) return;
    const [px, py] = place(event);
    const [x, y, w, h] = held.box;
    map.setAttribute("viewBox", [x - (px - held.at[0]) * w, y - (py - held.at[1]) * h, w, h].join(" "));
  });
  map.addEventListener("pointerup", () => { held = null; });
  map.addEventListener("keydown", (event) => {
    const [x, y, w, h] = box();
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (step) map.setAttribute("viewBox", [x + step[0] * w / 10, y + step[1] * h / 10, w, h].join(" "));
    else if (event.key === "+" || event.key === "=") zoom(0.8);
    else if (event.key === "-") zoom(1.25);
    else if (event.key === "0") map.setAttribute("viewBox", whole);
    else return;
    event.preventDefault();
  });
}
