// What a browser can tell of an opened report. Each function returns lists of words, or numbers to be held against others.
window.checks = (() => {
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const seen = (element) => element.getClientRects().length > 0 && element.checkVisibility();
  const name = (element) => `${element.tagName} ${element.id || element.getAttribute("class") || element.textContent.slice(0, 30)}`;
  const numbers = (text) => (text.match(/[\d.]+/g) || []).map(Number);

  const figures = () => {
    const found = [];
    if (all("figure").length === 0) found.push("no figure");
    for (const svg of all("figure svg")) {
      const box = svg.getBoundingClientRect();
      if (box.width < 150 || box.height < 15) found.push(`${name(svg)} is ${box.width} x ${box.height}`);
      const drawn = all(".line, .mark, rect", svg).filter((one) => {
        const size = one.getBoundingClientRect();
        return size.width + size.height > 0;
      });
      if (drawn.length === 0) found.push(`nothing is drawn in ${name(svg.closest("section"))}`);
      for (const one of all("path", svg)) if (/NaN|None|inf/.test(one.getAttribute("d"))) found.push(`${name(one)}: ${one.getAttribute("d").slice(0, 60)}`);
    }
    return found;
  };

  const overflow = () => {
    const wide = document.documentElement.clientWidth, found = [];
    if (document.documentElement.scrollWidth > wide) found.push(`the page is ${document.documentElement.scrollWidth} px wide, of ${wide}`);
    for (const one of all("body *")) {
      if (!seen(one) || (one.closest("svg") && one.tagName !== "svg") || one.closest(".on, thead")) continue;
      const box = one.getBoundingClientRect();
      if (box.width && (box.left < -0.5 || box.right > wide + 0.5)) found.push(`${name(one)} from ${box.left} to ${box.right}`);
      if (one.tagName !== "svg" && getComputedStyle(one).overflowX !== "auto" && one.scrollWidth > one.clientWidth + 1 && one.clientWidth > 0 && !one.matches(".x, .y, .x *, .y *"))
        found.push(`${name(one)} holds ${one.scrollWidth} px in ${one.clientWidth}`);
      if (getComputedStyle(one).overflowX === "auto" && one.scrollWidth > one.clientWidth + 1) found.push(`${name(one)} must be scrolled`);
    }
    return found;
  };

  const overlaps = () => {
    const found = [];
    const clash = (a, b) => a.left < b.right - 0.5 && b.left < a.right - 0.5 && a.top < b.bottom - 0.5 && b.top < a.bottom - 0.5;
    for (const group of [...all(".x"), ...all(".y"), ...all(".keys"), ...all(".tiles"), ...all(".panels")]) {
      const boxes = [...group.children].filter(seen).map((one) => [one, one.getBoundingClientRect()]);
      for (let i = 0; i < boxes.length; i += 1)
        for (let j = i + 1; j < boxes.length; j += 1)
          if (clash(boxes[i][1], boxes[j][1])) found.push(`${boxes[i][0].textContent.slice(0, 30)} and ${boxes[j][0].textContent.slice(0, 30)}`);
    }
    for (const one of all(".on")) {
      const words = document.createRange();
      words.selectNodeContents(one);
      const box = one.getBoundingClientRect(), text = words.getBoundingClientRect();
      if (text.top < box.bottom - 1 && (text.left < box.left - 0.5 || text.right > box.right + 0.5)) found.push(`${one.textContent} is cut`);
    }
    for (const ticks of all(".x")) {
      const right = ticks.closest(".card").getBoundingClientRect().right;
      for (const one of ticks.children) if (one.getBoundingClientRect().right > right) found.push(`${one.textContent} leaves its card`);
    }
    return found;
  };

  const light = (colour) => {
    const part = numbers(colour).slice(0, 3).map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * part[0] + 0.7152 * part[1] + 0.0722 * part[2];
  };
  const ratio = (a, b) => { const [low, high] = [light(a), light(b)].sort((x, y) => x - y); return (high + 0.05) / (low + 0.05); };
  const resolved = (element, property) => {
    const probe = document.createElement("i");
    probe.style.color = getComputedStyle(element).getPropertyValue(property);
    document.body.append(probe);
    const colour = getComputedStyle(probe).color;
    probe.remove();
    return colour;
  };
  const ground = (element) => {
    if (element.matches(".on")) return resolved(element, "--c");
    for (let one = element; one; one = one.parentElement) {
      const colour = getComputedStyle(one).backgroundColor;
      const alpha = numbers(colour)[3];
      if (alpha === undefined || alpha === 1) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const contrast = () => {
    const found = [];
    const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walk.nextNode()) {
      const element = walk.currentNode.parentElement;
      if (!walk.currentNode.textContent.trim() || !seen(element) || element.closest("svg")) continue;
      const of = ratio(getComputedStyle(element).color, ground(element));
      if (of < 4.5) found.push(`${name(element)}: ${of.toFixed(2)}`);
    }
    for (const one of all("svg .line, svg .mark, .map .robot.begin *, .map .robot.end *")) {
      const of = ratio(getComputedStyle(one).stroke, ground(one.closest("svg")));
      if (of < 3) found.push(`${name(one)}: ${of.toFixed(2)}`);
    }
    return [...new Set(found)];
  };

  // By the words of its ticks: from pixels to what they mean.
  const fit = (ticks, place) => {
    const known = [...ticks.children].map((one) => [place(one), parseFloat(one.textContent.replace(",", ""))]);
    const [[p0, v0], [p1, v1]] = [known[0], known[known.length - 1]];
    return (pixel) => v0 + ((pixel - p0) * (v1 - v0)) / (p1 - p0);
  };
  const across = (frame) => {
    const left = frame.querySelector("svg").getBoundingClientRect(), axis = frame.querySelector(".x");
    return fit(axis, (one) => left.left + (parseFloat(one.style.left) / 100) * left.width);
  };
  const upwards = (frame) => {
    const box = frame.querySelector("svg").getBoundingClientRect(), axis = frame.querySelector(".y");
    return fit(axis, (one) => box.top + (parseFloat(one.style.top) / 100) * box.height);
  };
  // Of what is drawn, without the width of its strokes.
  const extent = (one) => {
    const box = one.getBBox(), matrix = one.getScreenCTM();
    const at = (x, y) => new DOMPoint(x, y).matrixTransform(matrix);
    const [a, b] = [at(box.x, box.y), at(box.x + box.width, box.y + box.height)];
    return { left: Math.min(a.x, b.x), right: Math.max(a.x, b.x), top: Math.min(a.y, b.y), bottom: Math.max(a.y, b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, size: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  const robots = () => {
    const frame = document.querySelector(".map .frame");
    if (!frame) return null;
    const x = across(frame), y = upwards(frame);
    const places = ["begin", "end"].map((kind) => {
      const box = extent(frame.querySelector(`.robot.${kind} .body`));
      const front = extent(frame.querySelector(`.robot.${kind} .front`));
      return [x(box.x), y(box.y), Math.atan2(y(front.y) - y(box.y), x(front.x) - x(box.x))];
    });
    return { places, metre: 1 / Math.abs(x(1) - x(0)) };
  };
  const curves = () =>
    all("section[id^=plot-]").flatMap((section) =>
      all(".chart", section).flatMap((chart) => {
        const frame = chart.querySelector(".frame"), y = upwards(frame), x = across(frame);
        const panel = chart.querySelector("figcaption b").firstChild.textContent.trim();
        return all(".line", chart).map((line) => {
          const box = extent(line);
          return {
            plot: section.querySelector("h2").textContent, panel, label: line.querySelector("title").textContent,
            low: y(box.bottom), high: y(box.top), first: x(box.left), last: x(box.right), pixel: Math.abs(y(1) - y(0)),
          };
        });
      }));
  const modes = () => {
    const track = document.querySelector(".name.modes + .track");
    const box = track.querySelector("svg").getBoundingClientRect();
    return all("rect:not(.gap)", track).map((one) => {
      const size = one.getBoundingClientRect();
      return [one.querySelector("title").textContent, (size.left - box.left) / box.width, size.width / box.width, box.width];
    });
  };
  const texts = () => Object.fromEntries(all("[id]").map((one) => [one.id, one.textContent]));
  const foreign = () => all("script, img, link, iframe, object, embed, video, audio, form, base").map(name);

  return { figures, overflow, overlaps, contrast, robots, curves, modes, texts, foreign };
})();
