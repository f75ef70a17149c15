// Looks at the dashboard in Chromium as a maintenance engineer does: node dashboard.cjs URL FOLDER
// Needs playwright-core (NODE_PATH) and /usr/bin/chromium; leaves dashboard-desk.png and dashboard-phone.png in FOLDER.
const { chromium } = require("playwright-core");
const [url, folder] = process.argv.slice(2);

const check = (holds, what) => { if (!holds) throw new Error(what); };

async function main() {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || "/usr/bin/chromium",
    args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"],
  });
  for (const [name, viewport] of [["desk", { width: 1280, height: 900 }], ["phone", { width: 390, height: 844 }]]) {
    const page = await browser.newPage({ viewport, isMobile: name === "phone", hasTouch: name === "phone" });
    const elsewhere = [], errors = [];
    page.on("request", (request) => { if (!request.url().startsWith(url) && !request.url().startsWith("data:")) elsewhere.push(request.url()); });
    page.on("pageerror", (error) => errors.push(String(error)));
    page.on("console", (message) => { if (message.type() === "error") errors.push(message.text()); });
    await page.goto(url);
    await page.waitForFunction(() => document.getElementById("link").textContent === "connected");
    await page.waitForFunction(() => document.getElementById("source").textContent.includes("receiving"));
    await page.waitForFunction(() => document.querySelectorAll("#cycle-list li").length > 0, null, { timeout: 30000 });
    // The live curve is drawn: its canvas has more than ticks and grid.
    const inked = () => page.evaluate(() => {
      const canvas = document.getElementById("live"), pen = canvas.getContext("2d");
      const accent = getComputedStyle(document.documentElement).getPropertyValue("--a").trim();
      const [r, g, b] = [1, 3, 5].map((at) => parseInt(accent.slice(at, at + 2), 16));
      const { data } = pen.getImageData(0, 0, canvas.width, canvas.height);
      let count = 0;
      for (let at = 0; at < data.length; at += 4) count += data[at] === r && data[at + 1] === g && data[at + 2] === b;
      return count;
    });
    for (let tries = 0; tries < 50 && await inked() < 50; tries++) await page.waitForTimeout(200);
    check(await inked() >= 50, name + ": the live command is not drawn");
    if (name === "desk") {
      check((await page.textContent("#latched")).includes("Nobody has acknowledged it"), "the latched flag is not told");
      await page.click("#acknowledge button");
      await page.waitForFunction(() => document.getElementById("acknowledged").textContent.includes(", acknowledged"));
      await page.waitForFunction(() => document.getElementById("events").textContent.includes("acknowledged"));
      check(await page.isHidden("#acknowledge"), "the form stays");
    }
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
    check(wide <= 0, name + ": the page is " + wide + " px too wide");
    await page.screenshot({ path: folder + "/dashboard-" + name + ".png", fullPage: true });
    check(elsewhere.length === 0, "asked elsewhere: " + elsewhere);
    check(errors.length === 0, "errors: " + errors);
    console.log(name + ": " + (await page.textContent("#flag")) + ", " + (await page.textContent("#flow")) + " L/min");
    await page.close();
  }
  await browser.close();
}

main().catch((error) => { console.error(error); process.exit(1); });
