// Goes from an axis with cycles to a silent one and back, as who watches several presses does: node axes.cjs URL FOLDER
// Needs playwright-core (NODE_PATH) and /usr/bin/chromium; leaves axes-silent.png and axes-worn.png in FOLDER.
const { chromium } = require("playwright-core");
const [url, folder] = process.argv.slice(2);

const check = (holds, what) => { if (!holds) throw new Error(what); };

async function main() {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || "/usr/bin/chromium",
    args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"],
  });
  const page = await browser.newPage({ viewport: { width: 1280, height: 900 } });
  const errors = [];
  page.on("pageerror", (error) => errors.push(String(error)));
  await page.goto(url);
  const choose = async (axis) => {
    await page.waitForSelector("#overview button");
    await page.evaluate((axis) => [...document.querySelectorAll("#overview button")].find((one) => one.dataset.axis === axis).click(), axis);
    await page.waitForFunction((axis) => document.title.includes(axis), axis);
  };
  const listed = () => page.locator("#cycle-list li").count();
  const pictures = () => page.evaluate(() => ["cycle", "trend", "live"].map((id) => document.getElementById(id).toDataURL()));
  // The silent axis stands first and is chosen by itself: its pictures are the empty ones.
  await page.waitForFunction(() => document.title.includes("silent"));
  const empty = await pictures();
  check(await listed() === 0, "the silent axis has cycles");
  // The flags of the log were told before this page was opened.
  await page.waitForFunction(() => document.getElementById("events").textContent.includes("worn · "));
  const told = await page.textContent("#events");
  check(told.includes("→ leak"), "the leak's flag is forgotten: " + told);
  await choose("worn");
  await page.waitForFunction(() => document.querySelectorAll("#cycle-list li").length === 6);
  check((await pictures())[0] !== empty[0], "the cycles are not drawn");
  await page.screenshot({ path: folder + "/axes-worn.png", fullPage: true });
  // An order that is not taken is told.
  const dialog = page.waitForEvent("dialog");
  await page.route("**/acknowledge", (route) => route.fulfill({ status: 503, json: { error: "try again" } }));
  page.click("#acknowledge button");
  check((await dialog).message() === "try again", "the refusal is not told");
  await (await dialog).accept();
  await choose("silent");
  check(await listed() === 0, "the silent axis shows the other's cycles");
  check(JSON.stringify(await pictures()) === JSON.stringify(empty), "the silent axis shows the other's curves");
  // The stream was opened anew twice; no event is there twice.
  const items = await page.locator("#events li").allTextContents();
  check(await page.textContent("#events") === told, "the events changed: " + items);
  await page.screenshot({ path: folder + "/axes-silent.png", fullPage: true });
  check(errors.length === 0, "errors: " + errors);
  await browser.close();
}

main().catch((error) => { console.error(error); process.exit(1); });
