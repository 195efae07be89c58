"use strict";
(() => {
  const root = document.documentElement;
  const words = JSON.parse(document.getElementById("words").textContent);
  const chinese = () => root.lang.startsWith("zh");
  window.report = {
    words: () => words[chinese() ? "zh" : "en"],
    language: () => (chinese() ? "zh" : "en"),
    listeners: [],
  };

  function speak(language) {
    root.lang = language;
    for (const item of document.querySelectorAll("[aria-label][data-en]"))
      item.setAttribute("aria-label", chinese() ? item.dataset.zh : item.dataset.en);
    for (const item of document.querySelectorAll("option[data-en]"))
      item.textContent = chinese() ? item.dataset.zh : item.dataset.en;
    const button = document.getElementById("language");
    button.textContent = chinese() ? "English" : "中文";
    button.lang = chinese() ? "en" : "zh-Hans";
    document.title = document.querySelector(
      `h1 .${chinese() ? "zh" : "en"}`)?.textContent ?? document.title;
    for (const listener of window.report.listeners) listener();
  }
  document.getElementById("language").addEventListener(
    "click", () => speak(chinese() ? "en" : "zh-Hans"));
  if (chinese() || navigator.language.startsWith("zh")) speak("zh-Hans");

  document.getElementById("theme").addEventListener("click", () => {
    const dark = root.dataset.theme
      ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    for (const listener of window.report.listeners) listener();
  });

  // Parts: a link to a part opens the part; all parts are opened for printing.
  const parts = [...document.querySelectorAll("details.part")];
  const unfold = () => {
    const target = location.hash.length > 1 && document.getElementById(location.hash.slice(1));
    const part = target && (target.closest("details.part") ?? target.querySelector("details.part"));
    if (!part || part.open) return;
    part.open = true;
    target.scrollIntoView();
  };
  addEventListener("hashchange", unfold);
  for (const link of document.querySelectorAll('a[href^="#"]'))
    link.addEventListener("click", () => setTimeout(unfold)); // the hash may be there already
  unfold();
  let folded = [];
  addEventListener("beforeprint", () => {
    folded = [...folded, ...parts.filter((part) => !part.open)];
    for (const part of folded) part.open = true;
  });
  addEventListener("afterprint", () => {
    for (const part of folded) part.open = false;
    folded = [];
  });

  // Tables: by number where a cell has one, else by text; the third click restores the order.
  function key(row, column) {
    const cell = row.cells[column];
    if (cell.dataset.v === undefined) return cell.innerText.trim();
    const value = parseFloat(cell.dataset.v);
    return Number.isNaN(value) ? Infinity : value;
  }
  const number = (value) => typeof value === "number";
  function compare(one, two) {
    if (number(one) && number(two)) return one === two ? 0 : one - two;
    if (number(one) !== number(two)) return number(one) ? -1 : 1;
    return one.localeCompare(two, undefined, { numeric: true });
  }
  for (const table of document.querySelectorAll("table")) {
    const body = table.tBodies[0];
    const given = [...body.rows];
    for (const header of table.tHead.rows[0].cells)
      header.querySelector("button").addEventListener("click", () => {
        const now = header.getAttribute("aria-sort");
        const next = now === "ascending" ? "descending" : now ? null : "ascending";
        for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
        let rows = [...given];
        if (next) {
          header.setAttribute("aria-sort", next);
          const sign = next === "ascending" ? 1 : -1;
          const column = header.cellIndex;
          rows.sort((one, two) => sign * compare(key(one, column), key(two, column)));
        }
        body.append(...rows);
      });
  }

  // Plots: the tip shows the values of the point nearest to the pointer.
  const tip = document.getElementById("tip");
  const hide = () => { tip.hidden = true; };
  for (const drawing of document.querySelectorAll(".plot > svg")) {
    const series = [...drawing.querySelectorAll("[data-labels]")].map((line) => ({
      line, labels: line.dataset.labels.split("|"), points: [...line.points],
      reach: Number(line.dataset.reach ?? 40),
    }));
    if (!series.length) continue;
    const ring = document.createElementNS("http://www.w3.org/2000/svg", "circle");
    ring.setAttribute("class", "ring");
    ring.setAttribute("r", "6");
    drawing.addEventListener("pointermove", (event) => {
      const matrix = drawing.getScreenCTM();
      const here = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
      let best = null;
      for (const one of series)
        one.points.forEach((point, index) => {
          const distance = Math.hypot(point.x - here.x, point.y - here.y);
          if (!best || distance < best.distance) best = { one, point, index, distance };
        });
      if (!best || best.distance > best.one.reach) { hide(); ring.remove(); return; }
      const data = best.one.line.dataset;
      tip.textContent = `${chinese() ? data.zh : data.en}: ${best.one.labels[best.index]}`;
      tip.hidden = false;
      const wide = tip.offsetWidth;
      tip.style.left = `${Math.min(event.clientX + 14, innerWidth - wide - 8)}px`;
      tip.style.top = `${Math.max(event.clientY - 38, 4)}px`;
      ring.setAttribute("cx", best.point.x);
      ring.setAttribute("cy", best.point.y);
      drawing.append(ring);
    });
    drawing.addEventListener("pointerleave", () => { hide(); ring.remove(); });
  }
  addEventListener("scroll", hide, { passive: true });

  // A plot as a file: the styles of the style sheet are copied into the elements.
  const kept = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray",
    "stroke-linejoin", "font-size", "font-family", "display"];
  function alone(drawing) {
    const copy = drawing.cloneNode(true);
    const originals = drawing.querySelectorAll("*");
    copy.querySelectorAll("*").forEach((item, index) => {
      const style = getComputedStyle(originals[index]);
      for (const name of kept) item.style.setProperty(name, style.getPropertyValue(name));
    });
    const box = drawing.viewBox.baseVal;
    copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
    copy.setAttribute("width", box.width);
    copy.setAttribute("height", box.height);
    copy.style.background = getComputedStyle(document.body).backgroundColor;
    return new XMLSerializer().serializeToString(copy);
  }
  function offer(address, name) {
    const link = document.createElement("a");
    link.href = address;
    link.download = name;
    link.click();
  }
  for (const button of document.querySelectorAll(".save"))
    button.addEventListener("click", () => {
      const drawing = button.closest("figure").querySelector(":scope > svg");
      const address = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(alone(drawing))}`;
      if (button.dataset.as === "svg") { offer(address, "plot.svg"); return; }
      const picture = new Image();
      picture.onload = () => {
        const canvas = document.createElement("canvas");
        const box = drawing.viewBox.baseVal;
        canvas.width = 2 * box.width;
        canvas.height = 2 * box.height;
        const context = canvas.getContext("2d");
        context.fillStyle = getComputedStyle(document.body).backgroundColor;
        context.fillRect(0, 0, canvas.width, canvas.height);
        context.drawImage(picture, 0, 0, canvas.width, canvas.height);
        offer(canvas.toDataURL("image/png"), "plot.png");
      };
      picture.src = address;
    });
})();
