// Checks of a page, called by test_page.py. Each function returns a list of problems, empty if there are none.

const name = (element) => {
  const about = element.id || element.getAttribute("class") || element.textContent.trim().slice(0, 40);
  return `<${element.localName}> ${about.replace(/\s+/g, " ")}`;
};
const visible = (element) => element.checkVisibility({ visibilityProperty: true, contentVisibilityAuto: false });
const elements = (selector = "body *") => [...document.querySelectorAll(selector)].filter(visible);
const ancestors = (element) => {
  const found = [];
  for (let each = element; each; each = each.parentElement) found.push(each);
  return found;
};

function openAll() {
  document.querySelectorAll("details").forEach((each) => { each.open = true; });
}

// replace images of SVG files by inline SVG with the same filter, so that their text can be examined
function unpackPictures() {
  for (const image of document.querySelectorAll('img[src^="data:image/svg+xml"]')) {
    const bytes = Uint8Array.from(atob(image.src.split(",")[1]), (c) => c.charCodeAt(0));
    const text = new TextDecoder().decode(bytes);
    const { width, height } = image.getBoundingClientRect();
    const holder = document.createElement("div");
    holder.innerHTML = text.slice(text.indexOf("<svg"));
    const picture = holder.querySelector("svg");
    picture.dataset.filter = getComputedStyle(image).filter;
    picture.style.fill = "#000";  // the page's styles do not apply inside an image
    picture.setAttribute("width", width);
    picture.setAttribute("height", height);
    image.replaceWith(picture);
  }
}

// horizontal scrolling of the page, and elements that reach past its edge
function tooWide(width) {
  const root = document.scrollingElement;
  const wrong = [];
  if (window.innerWidth !== width) wrong.push(`the window is ${window.innerWidth} wide`);
  if (root.scrollWidth > root.clientWidth) wrong.push(`the page is ${root.scrollWidth} of ${root.clientWidth} wide`);
  const boxed = (element) => ancestors(element.parentElement).slice(0, -2)
    .some((each) => ["auto", "scroll"].includes(getComputedStyle(each).overflowX));
  for (const element of elements("body *:not(svg *)")) {
    const { right, width: own } = element.getBoundingClientRect();
    if (own > 1 && right > root.clientWidth + 1 && !boxed(element)) wrong.push(`${name(element)} ends at ${right}`);
  }
  return wrong.slice(0, 5);
}

// elements below the first screen
function belowTheFold(selector) {
  return elements(selector).filter((each) => each.getBoundingClientRect().bottom > window.innerHeight).map(name);
}

// boxes with hidden content, which cannot be scrolled on paper
function cutOff() {
  return elements("body *:not(svg *)").filter((each) => {
    const { overflowX, overflowY } = getComputedStyle(each);
    const small = each.clientWidth <= 1;  // text for screen readers only
    return !small && ((overflowX !== "visible" && each.scrollWidth > each.clientWidth + 1)
      || (overflowY !== "visible" && each.scrollHeight > each.clientHeight + 1));
  }).map(name);
}

// boxes that scroll sideways, except some
function scrolling(except) {
  return elements("body *:not(svg *)").filter((each) => !each.matches(except)
    && getComputedStyle(each).overflowX !== "visible" && each.scrollWidth > each.clientWidth + 1).map(name);
}

// elements larger than a sheet, which have to break
function tallerThan(height) {
  return elements("figure, tr").filter((each) => each.getBoundingClientRect().height > height).map(name);
}

// boxes of a text: those of its parts, since exponents and indices make the box of the whole too high
function boxes(text) {
  const parts = [...text.querySelectorAll("tspan")].filter((part) => !part.children.length);
  return (parts.length ? parts : [text]).map((part) => part.getBoundingClientRect());
}

function overlap(one, other) {
  const wide = Math.min(one.right, other.right) - Math.max(one.left, other.left);
  const high = Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top);
  return wide > 2 && high > 0.3 * Math.min(one.height, other.height);
}

// texts of a picture that overlap or reach past its edge
function colliding() {
  const wrong = [];
  for (const picture of elements("svg")) {
    const texts = [...picture.querySelectorAll("text")].filter(visible).filter((each) => Math.abs(each.getScreenCTM().b) < 1e-6).map((each) => [each.textContent.trim(), boxes(each)]);
    texts.forEach(([words, ones], i) => {
      if (ones.some((one) => one.right > document.scrollingElement.clientWidth + 1 || one.left < -1)) wrong.push(`${words} past the edge`);
      for (const [others, other] of texts.slice(i + 1)) {
        if (ones.some((one) => other.some((box) => overlap(one, box)))) wrong.push(`${words} on ${others}`);
      }
    });
  }
  return wrong;
}

function brokenLinks() {
  return [...document.querySelectorAll("a")].map((each) => each.getAttribute("href")).filter((href) =>
    !href || !href.startsWith("#") || !document.getElementById(decodeURIComponent(href.slice(1))));
}

function repeatedIds() {
  const ids = [...document.querySelectorAll("[id]")].map((each) => each.id);
  return ids.filter((id, i) => ids.indexOf(id) !== i);
}

// pictures without a text for screen readers
function nameless() {
  const bare = "img:not([alt]), img[alt=''], svg:not([aria-label]):not(:has(> title))";
  return [...document.querySelectorAll(bare)].map(name);
}

function aboutItself() {
  return [
    !document.documentElement.lang && "no language",
    !document.title && "no title",
    window === top && document.compatMode !== "CSS1Compat" && "no doctype",
  ].filter(Boolean);
}

function headings() {
  return [...document.querySelectorAll("h1, h2, h3, h4, h5, h6")]
    .map((each) => [Number(each.localName[1]), each.textContent.trim()]);
}

// all text, with everything unfolded
function text() {
  openAll();
  return document.body.innerText.replace(/\s+/g, " ");
}

// moves a pointer over every picture, so that its scripts run
function touchAll() {
  for (const picture of document.querySelectorAll("svg, img, canvas")) {
    const { left, top, width, height } = picture.getBoundingClientRect();
    for (const share of [0.1, 0.5, 0.9]) {
      const place = { bubbles: true, clientX: left + share * width, clientY: top + height / 2 };
      for (const kind of ["pointermove", "pointerdown", "pointerup", "pointerleave"]) {
        picture.dispatchEvent(new PointerEvent(kind, place));
      }
    }
  }
}

// short words that are broken
function torn() {
  const found = [];
  for (const element of elements("h1, h2, h3, th, td, dt, summary, caption, nav a, b")) {
    for (const node of element.childNodes) {
      if (node.nodeType !== Node.TEXT_NODE) continue;
      for (const { 0: word, index } of node.data.matchAll(/[\p{L}\d]{2,14}/gu)) {
        const range = document.createRange();
        range.setStart(node, index);
        range.setEnd(node, index + word.length);
        if (new Set([...range.getClientRects()].map((box) => Math.round(box.top))).size > 1) found.push(word);
      }
    }
  }
  return found;
}

function hidden(selector) {
  return [...document.querySelectorAll(selector)].filter((each) => !visible(each)).map(name);
}

// any CSS colour as red, green, blue, alpha
const paint = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
const rgba = (colour) => {
  paint.clearRect(0, 0, 1, 1);
  paint.fillStyle = colour;
  paint.fillRect(0, 0, 1, 1);
  const [r, g, b, a] = paint.getImageData(0, 0, 1, 1).data;
  return [r, g, b, a / 255];
};
const filtered = (colour, filter) => {
  paint.filter = filter;
  const shown = rgba(`rgb(${colour.slice(0, 3)})`);
  paint.filter = "none";
  return shown.slice(0, 3);
};
const over = (top, below) => [0, 1, 2].map((i) => top[3] * top[i] + (1 - top[3]) * below[i]);
// WCAG 2.2, relative luminance and contrast ratio
const luminance = (colour) => colour
  .map((value) => value / 255)
  .map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4))
  .reduce((sum, value, i) => sum + value * [0.2126, 0.7152, 0.0722][i], 0);
const ratio = (one, other) => {
  const [dark, light] = [luminance(one), luminance(other)].sort((a, b) => a - b);
  return (light + 0.05) / (dark + 0.05);
};
const canvasColour = () => rgba(getComputedStyle(document.documentElement).colorScheme.includes("dark")
  && matchMedia("(prefers-color-scheme: dark)").matches && !matchMedia("print").matches ? "#121212" : "#ffffff");

// areas of a picture painted below the middle of a text
function painted(text) {
  const { left, right, top, bottom } = text.getBoundingClientRect();
  const covers = (each) => {
    if (!(each.compareDocumentPosition(text) & Node.DOCUMENT_POSITION_FOLLOWING)) return false;
    const middle = new DOMPoint((left + right) / 2, (top + bottom) / 2);
    return each.isPointInFill(middle.matrixTransform(each.getScreenCTM().inverse()));
  };
  return [...text.ownerSVGElement.querySelectorAll(":not(defs *):is(path, rect, circle)")].filter(visible).filter(covers);
}

function background(element) {
  let below = canvasColour().slice(0, 3);
  for (const each of ancestors(element).reverse()) below = over(rgba(getComputedStyle(each).backgroundColor), below);
  if (element.ownerSVGElement) {
    for (const each of painted(element)) {
      const { fill, fillOpacity, opacity } = getComputedStyle(each);
      if (fill === "none" || fill.startsWith("url")) continue;
      const [r, g, b, a] = rgba(fill);
      below = over([r, g, b, a * fillOpacity * opacity], below);
    }
  }
  return below;
}

// contrast of every kind of text: the lowest ratio by tag, class and colours
function contrasts() {
  const found = new Map();
  for (const element of elements()) {
    const words = [...element.childNodes].some((each) => each.nodeType === Node.TEXT_NODE && each.data.trim());
    if (!words) continue;
    const style = getComputedStyle(element);
    const below = background(element);
    const faded = ancestors(element).reduce((share, each) => share * getComputedStyle(each).opacity, 1);
    const ink = rgba(element.ownerSVGElement ? style.fill : style.color);
    const filter = element.ownerSVGElement?.dataset.filter ?? "none";
    const shown = [over([...ink.slice(0, 3), ink[3] * faded], below), below].map((each) => filtered(each, filter));
    const value = ratio(...shown);
    const kind = `${element.localName}.${element.getAttribute("class") || ""} rgb(${ink.slice(0, 3)}) on rgb(${below.map(Math.round)})`;
    if (!found.has(kind)) found.set(kind, [value, element.textContent.trim().slice(0, 30)]);
  }
  return [...found].map(([kind, [value, words]]) => [kind, value, words]);
}

// elements that break between two sheets of paper but should not
function breakable(selector) {
  return elements(selector).filter((each) => getComputedStyle(each).breakInside !== "avoid").map(name);
}

function pageColour() {
  return background(document.body);
}
