// Contrast of what a page writes and draws (WCAG 2.2), for evaluation within the page.

// The lowest contrast of a text with what is behind it, and where.
function worstContrast() {
  const parse = (text) => { const [r, g, b, a = 1] = text.match(/[\d.]+/g).map(Number); return { r, g, b, a }; };
  const over = (front, back) => ({ r: front.r * front.a + back.r * (1 - front.a), g: front.g * front.a + back.g * (1 - front.a), b: front.b * front.a + back.b * (1 - front.a), a: 1 });
  const light = ({ r, g, b }) => { const [x, y, z] = [r, g, b].map((c) => { c /= 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; }); return 0.2126 * x + 0.7152 * y + 0.0722 * z; };
  const behind = (element) => {
    const layers = [];
    for (let at = element; at; at = at.parentElement) layers.push(parse(getComputedStyle(at).backgroundColor));
    return layers.reverse().reduce((back, front) => over(front, back), { r: 255, g: 255, b: 255, a: 1 });
  };
  let worst = { ratio: 21, where: "" };
  for (const element of document.querySelectorAll("body *")) {
    const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!(own || ["INPUT", "SELECT"].includes(element.tagName)) || !element.checkVisibility()) continue;
    const back = behind(element), front = over(parse(getComputedStyle(element).color), back), [a, b] = [light(front), light(back)].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < worst.ratio) worst = { ratio, where: element.tagName + "#" + element.id + "." + element.className + ": " + element.textContent.slice(0, 40) };
  }
  return worst;
}

// The colours that canvases write and draw with, on the panels.
function worstInk() {
  const light = (hex) => { const [x, y, z] = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255).map((c) => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4); return 0.2126 * x + 0.7152 * y + 0.0722 * z; };
  const full = (hex) => hex.length === 4 ? "#" + [...hex.slice(1)].map((c) => c + c).join("") : hex;
  const value = (name) => full(getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim());
  const panel = light(value("panel"));
  const ratios = ["text", "soft", "a", "b", "healthy", "watch", "leak", "severe", "no_estimate"].map((name) => {
    const [a, b] = [light(value(name)), panel].sort((x, y) => y - x);
    return { ratio: (a + 0.05) / (b + 0.05), where: "--" + name };
  });
  return ratios.reduce((worst, one) => one.ratio < worst.ratio ? one : worst);
}

module.exports = { worstContrast, worstInk };
