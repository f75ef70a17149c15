// Looks at each machine of a page in Chromium, as people do who walk by: node window.cjs URL FOLDER TOKEN
// Logs in, and goes through every machine on desk and phone, in light and dark: what is told, contrast, width, nothing from elsewhere; then by the
// keyboard alone. Needs playwright-core (NODE_PATH) and /usr/bin/chromium; leaves MACHINE-DEVICE-SCHEME.png in FOLDER.
const { chromium } = require("playwright-core");
const { worstContrast, worstInk } = require("./contrast.cjs");
const [url, folder, token] = process.argv.slice(2);

const check = (holds, what) => { if (!holds) throw new Error(what); };

const SAYS = {
  alarm: { flag: "severe", verdict: /should not run/, todo: /Stop the machine/, flow: /^\d/, cost: /kWh a year, \d+ EUR a year/, until: /time now/, part: /piston seal/ },
  learning: { flag: "no estimate|healthy", verdict: /\w/, todo: /\w/, baseline: /learning the healthy machine: \d+ of 50/ },
  silent: { flag: "no estimate", verdict: /no command comes/, todo: /Bring the bus back/, flow: /^–$/ },
  stuck: { flag: "no estimate", verdict: /There is no estimate: /, todo: /\w/, flow: /^–$/ },
};

async function choose(page, machine) {
  await page.waitForSelector("#overview button");
  await page.evaluate((axis) => [...document.querySelectorAll("#overview button")].find((one) => one.dataset.axis === axis).click(), machine);
  await page.waitForFunction((axis) => document.title.includes(" " + axis + " "), machine);
}

async function lookAt(page, machine, name) {
  await choose(page, machine);
  const says = SAYS[machine], text = (id) => page.textContent("#" + id);
  if (machine === "silent" || machine === "stuck") await page.waitForFunction(() => !document.getElementById("why").hidden);
  if (machine === "alarm") await page.waitForFunction(() => document.querySelectorAll("#cycle-list li").length > 0);
  check(new RegExp("^(" + says.flag + ")$").test(await text("flag")), machine + " is told as " + await text("flag"));
  for (const id of ["verdict", "todo", "flow", "cost", "until", "part", "baseline"]) {
    if (says[id]) check(says[id].test(await text(id)), machine + ", " + id + ": " + await text(id));
  }
  // From three metres: the flag is the largest thing there is.
  const size = await page.evaluate(() => parseFloat(getComputedStyle(document.getElementById("flag")).fontSize));
  check(size >= 44, "the flag is " + size + " px high");
  for (const worst of [await page.evaluate(worstContrast), await page.evaluate(worstInk)]) {
    check(worst.ratio >= 4.5, machine + ", " + name + ": contrast " + worst.ratio.toFixed(2) + " of " + worst.where);
  }
  const wide = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  check(wide <= 0, machine + ", " + name + ": the page is " + wide + " px too wide");
  await page.screenshot({ path: folder + "/" + machine + "-" + name + ".png", fullPage: true });
}

// Reads the curves, takes note of the flag and notes a repair, without a pointer.
async function byKeys(page) {
  const reach = async (id) => {
    for (let tries = 0; tries < 80; tries++) {
      if (await page.evaluate((id) => document.activeElement.id === id, id)) return;
      await page.keyboard.press("Tab");
    }
    throw new Error("the keyboard does not reach " + id);
  };
  await choose(page, "alarm");
  await page.waitForFunction(() => Boolean(document.getElementById("trend").picture));
  await page.evaluate(() => document.activeElement.blur());
  await reach("acknowledge-who");
  await page.keyboard.type("M. Huber");
  await page.keyboard.press("Tab");
  await page.keyboard.type("kit ordered");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => !document.getElementById("acknowledged").hidden);
  const by = await page.textContent("#acknowledged");
  check(by.includes("acknowledged by M. Huber (kit ordered)"), by);
  await reach("trend");
  const outlined = await page.evaluate(() => getComputedStyle(document.activeElement).outlineStyle !== "none");
  check(outlined, "the focus is not to be seen");
  await page.keyboard.press("ArrowLeft");
  const read = await page.textContent("#trend-readout");
  check(/L\/min \(.* … .*\), .* mm², \w+/.test(read), "the trend says " + read);
  const shown = () => page.evaluate(() => document.getElementById("trend").picture.shown);
  const all = await shown();
  await page.keyboard.press("+");
  const part = await shown();
  check(part[1] - part[0] < 0.6 * (all[1] - all[0]), "the trend does not zoom");
  await page.keyboard.press("0");
  // All of now: cycles may have come since.
  const [again, ends] = await page.evaluate(() => { const { shown, ends } = document.getElementById("trend").picture; return [shown, ends]; });
  check(JSON.stringify(again) === JSON.stringify(ends), "the trend does not show all again");
  await reach("cycle");
  await page.keyboard.press("ArrowRight");
  check(/^\d.*%/.test(await page.textContent("#cycle-readout")), "the cycle cannot be read");
  await reach("repair-who");
  await page.keyboard.type("M. Huber");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.getElementById("repairs").textContent.includes("seal replaced (M. Huber)"));
}

// A finger reads, a mouse zooms.
async function byPointer(page, isPhone) {
  await choose(page, "alarm");
  await page.waitForFunction(() => Boolean(document.getElementById("trend").picture));
  await page.locator("#trend").scrollIntoViewIfNeeded();
  const box = await page.locator("#trend").boundingBox();
  if (isPhone) {
    await page.touchscreen.tap(box.x + box.width * 0.7, box.y + box.height * 0.5);
    check((await page.textContent("#trend-readout")).includes("L/min"), "a finger reads nothing");
    return;
  }
  await page.mouse.move(box.x + box.width * 0.4, box.y + 60);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width * 0.8, box.y + 60, { steps: 4 });
  await page.mouse.up();
  const [from, to] = await page.evaluate(() => document.getElementById("trend").picture.shown), [first, last] = await page.evaluate(() => document.getElementById("trend").picture.ends);
  check(to - from < 0.6 * (last - first), "a drag does not zoom");
  await page.click("#zoom-all");
}

async function main() {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || "/usr/bin/chromium",
    args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"],
  });
  // The desk comes last: there a new seal is noted, which ends the alarm.
  for (const [device, viewport] of [["phone", { width: 390, height: 844 }], ["desk", { width: 1280, height: 900 }]]) {
    const isPhone = device === "phone";
    const page = await browser.newPage({ viewport, isMobile: isPhone, hasTouch: isPhone });
    const elsewhere = [], errors = [];
    page.on("request", (request) => { if (!request.url().startsWith(url) && !request.url().startsWith("data:")) elsewhere.push(request.url()); });
    page.on("pageerror", (error) => errors.push(String(error)));
    // The login form comes with a 401.
    page.on("console", (message) => { if (message.type() === "error" && !message.text().includes("401")) errors.push(message.text()); });
    await page.goto(url);
    check((await page.evaluate(worstContrast)).ratio >= 4.5, "the form cannot be read");
    await page.keyboard.type("not the token");
    await page.keyboard.press("Enter");
    await page.waitForSelector(".refused");
    await page.keyboard.type(token);
    await page.screenshot({ path: folder + "/login-" + device + ".png", fullPage: true });
    await page.keyboard.press("Enter");
    await page.waitForFunction(() => document.getElementById("link")?.textContent === "connected");
    for (const scheme of ["light", "dark"]) {
      await page.emulateMedia({ colorScheme: scheme });
      for (const machine of Object.keys(SAYS)) await lookAt(page, machine, device + "-" + scheme);
    }
    await byPointer(page, isPhone);
    if (!isPhone) await byKeys(page);
    check(elsewhere.length === 0, "asked elsewhere: " + elsewhere);
    check(errors.length === 0, "errors: " + errors);
    await page.close();
  }
  await browser.close();
}

main().catch((error) => { console.error(error); process.exit(1); });
