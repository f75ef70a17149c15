// Reads a report as it is sent to a phone and put on paper: node report.cjs FILE FOLDER
// Needs playwright-core (NODE_PATH) and /usr/bin/chromium; leaves report-phone-SCHEME.png and report-paper.png in FOLDER.
const { chromium } = require("playwright-core");
const { worstContrast, worstInk } = require("./contrast.cjs");
const [file, folder] = process.argv.slice(2);

const check = (holds, what) => { if (!holds) throw new Error(what); };

// The smallest writing of the drawings that are shown, px on the screen.
function smallestWriting() {
  const sizes = [...document.querySelectorAll("svg")].filter((svg) => svg.checkVisibility())
    .map((svg) => svg.getBoundingClientRect().width / svg.viewBox.baseVal.width * parseFloat(getComputedStyle(svg.querySelector("text")).fontSize));
  return { smallest: Math.min(...sizes), drawings: sizes.length };
}

async function main() {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || "/usr/bin/chromium",
    args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"],
  });
  const views = [["phone-light", 390, { colorScheme: "light" }], ["phone-dark", 390, { colorScheme: "dark" }], ["paper", 720, { media: "print", colorScheme: "dark" }]];
  for (const [name, width, media] of views) {
    const page = await browser.newPage({ viewport: { width, height: 844 } });
    const asked = [];
    page.on("request", (request) => asked.push(request.url()));
    await page.emulateMedia(media);
    await page.goto("file://" + file);
    check(asked.length === 1, name + ": asked for " + asked);
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
    check(wide <= 0, name + ": the page is " + wide + " px too wide");
    for (const worst of [await page.evaluate(worstContrast), await page.evaluate(worstInk)]) {
      check(worst.ratio >= 4.5, name + ": contrast " + worst.ratio.toFixed(2) + " of " + worst.where);
    }
    const { smallest, drawings } = await page.evaluate(smallestWriting);
    check(drawings >= 4 && smallest >= 9, name + ": the writing of " + drawings + " drawings is " + smallest.toFixed(1) + " px high");
    if (name === "paper") check(await page.evaluate(() => getComputedStyle(document.body).backgroundColor) === "rgb(255, 255, 255)", "paper is not white");
    await page.screenshot({ path: folder + "/report-" + name + ".png", fullPage: true });
    await page.close();
  }
  await browser.close();
}

main().catch((error) => { console.error(error); process.exit(1); });
