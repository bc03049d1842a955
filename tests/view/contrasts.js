// The contrast of every visible text with what is behind it, as WCAG counts it, and what AA demands.
() => {
  const dot = Object.assign(document.createElement("canvas"), {width: 1, height: 1});
  const pen = dot.getContext("2d", {willReadFrequently: true});
  const luminance = (layers) => {
    for (const [color, opacity] of layers) {
      Object.assign(pen, {fillStyle: color, globalAlpha: opacity}).fillRect(0, 0, 1, 1);
    }
    const [r, g, b] = [...pen.getImageData(0, 0, 1, 1).data].map((v) => v / 255)
      .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const found = [];
  const look = (element, text, style) => {
    const box = element.getBoundingClientRect();
    if (!text.trim() || box.width < 2 || box.height < 2) return;
    if (!element.checkVisibility({checkOpacity: true, checkVisibilityCSS: true})) return;
    const size = parseFloat(style.fontSize);
    const needed = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700) ? 3 : 4.5;
    const around = [];
    for (let at = element; at !== document.body; at = at.parentElement) around.unshift(getComputedStyle(at));
    const opacity = around.reduce((product, each) => product * Number(each.opacity), 1);
    // Where something lies half-transparent on the picture, black and white may be under it.
    const ratios = ["black", "white"].map((ground) => {
      const under = [[ground, 1], ...around.map((each) => [each.backgroundColor, 1])];
      const [low, high] = [luminance(under), luminance([...under, [style.color, opacity]])].sort((a, b) => a - b);
      return (high + 0.05) / (low + 0.05);
    });
    found.push({text: text.trim().slice(0, 60), id: element.id, ratio: Math.min(...ratios), needed});
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (["SCRIPT", "STYLE", "NOSCRIPT", "OPTION"].includes(element.tagName)) continue;
    look(element, walker.currentNode.data, getComputedStyle(element));
  }
  for (const element of document.querySelectorAll("input, select, textarea")) {
    if (["checkbox", "radio", "range"].includes(element.type)) continue;
    if (element.value) look(element, element.value, getComputedStyle(element));
    else look(element, element.placeholder ?? "", getComputedStyle(element, "::placeholder"));
  }
  return found;
}
