"""The designer's page as its user feels it: from a slider's event to the plots painted, and what many moves leave.

    python benchmarks/designer_page.py [--rounds 100] [--moves 3000] [--job JOB.toml] [--loop NAME ...] [--budget]

Two times each: until the loop's curves and bands are painted, and until it is measured and that is painted as well;
beside them the processor time of the server for each move, which other processes on the machine change less.
With --budget the page shows the budget of the line of sight (examples/camera_gimbal.toml unless another job is given):
the time until it is painted stands beside the time until the loop is measured as well.
A real Chromium without a window, drawing by software; the server in a process of its own. Needs the extra `test`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

JOB = Path(__file__).parent.parent / "examples" / "three_gyro_platform.toml"
CAMERA = JOB.with_name("camera_gimbal.toml")
ALLOWED = 100.0  # ms, from the event to the plots painted
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking")
SLIDERS = ("speed", "robustness", "crossover_hz", "position_hz", "filter_hz", "damping_hz", "lead_hz")
# Moves a slider `rounds` times around where it stands; each time waits until the answer is painted.
MOVE = """async ([name, rounds, painted]) => {
  const slider = document.querySelector(`#sliders [data-slider="${name}"] input[type="range"]`);
  const middle = Number(slider.value), times = [];
  // The table of the budget changes in the frame in which its plots are painted.
  let budget = NaN, curves = NaN, began = 0;
  const table = document.querySelector("#panel-budget");
  const late = () => setTimeout(() => { budget = performance.now() - began; }, 0);
  const watcher = new MutationObserver(() => requestAnimationFrame(late));
  if (table) watcher.observe(table, { subtree: true, characterData: true, childList: true });
  // Several curves may come in one frame: the first of them tells it.
  const loops = [...Bokeh.documents[0]._all_models.values()].filter((one) => one.name === "bode-figure-0-lines");
  let waiting = false;
  const drawn = () => {
    if (!waiting) return;
    waiting = false;
    requestAnimationFrame(() => setTimeout(() => { curves = performance.now() - began; }, 0));
  };
  for (const one of loops) one.properties.data.change.connect(drawn);
  for (let k = 0; k < rounds; k += 1) {
    began = performance.now();
    waiting = true;
    slider.value = middle + 3 + (k % 2 ? k % 40 : -(k % 40));
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    await new Promise((done) => {
      const heard = () => {
        if (!window.page.settled()) return;
        window.removeEventListener("response", heard);
        if (!painted) { done(); return; }
        // After the frame in which the plots are painted.
        requestAnimationFrame(() => setTimeout(done, 0));
      };
      window.addEventListener("response", heard);
    });
    const picture = Number.parseFloat(document.querySelector("#elapsed").textContent);
    times.push([performance.now() - began, picture, budget, curves]);
  }
  watcher.disconnect();
  for (const one of loops) one.properties.data.change.disconnect(drawn);
  return times;
}"""


def server_memory(process: subprocess.Popen[str]) -> float:
    """Return the resident memory of the server, MB; nan where the system does not tell."""
    try:
        text = Path(f"/proc/{process.pid}/statm").read_text(encoding="ascii")
    except OSError:
        return float("nan")
    return int(text.split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def server_time(process: subprocess.Popen[str]) -> float:
    """Return the processor time that the server has taken, ms; nan where the system does not tell."""
    try:
        text = Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii")
    except OSError:
        return float("nan")
    ticks = text.rpartition(")")[2].split()[11:13]
    return 1e3 * sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def page_memory(talk: Any) -> float:
    """Return what the page's JavaScript holds after its rubbish was collected, MB."""
    talk.send("HeapProfiler.collectGarbage")
    metrics = talk.send("Performance.getMetrics")["metrics"]
    return float(next(one["value"] for one in metrics if one["name"] == "JSHeapUsedSize")) / 1e6


def quantiles(times: list[float | None]) -> tuple[float, float]:
    """Return the median and the time that 95 % keep; nan where nothing was painted."""
    known = sorted(one for one in times if one is not None)
    return (statistics.median(known), known[int(0.95 * (len(known) - 1))]) if known else (math.nan, math.nan)


def sliders_timed(page: Any, process: subprocess.Popen[str], rounds: int, budget: bool) -> list[str]:
    """Print the times of each slider of the loop that is shown, and return the sliders."""
    print(f"{page.locator('#loop').input_value()}, allowed {ALLOWED:g} ms")
    heads = "".join(f"{word:>9}" for word in ("painted", "95 %", "measured", "95 %", "picture", "server"))
    print(f"{'slider':<14}{heads}   painted, measured")
    sliders = [one for one in SLIDERS if page.locator(f'#sliders [data-slider="{one}"]').count()]
    for name in sliders:
        page.evaluate(MOVE, [name, 10, True])
        begun = server_time(process)
        times = page.evaluate(MOVE, [name, rounds, True])
        busy = (server_time(process) - begun) / rounds
        (curves, curves_late), (whole, late) = (quantiles([one[k] for one in times]) for k in (3, 0))
        picture = statistics.median(one[1] for one in times)
        columns = "".join(f"{one:6.0f} ms" for one in (curves, curves_late, whole, late, picture, busy))
        words = f"{name:<14}{columns}   {curves / ALLOWED:5.2f} {whole / ALLOWED:5.2f}"
        if budget:
            painted = statistics.median(one[2] for one in times)
            words += f"   budget painted {painted:4.0f} ms, {painted / ALLOWED:5.2f}"
        print(words, flush=True)
    return sliders


def main() -> None:
    """Print the times of each slider and the memory before and after many moves."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=100, help="moves of each slider that are timed")
    parser.add_argument("--moves", type=int, default=3000, help="moves after which memory is looked at again")
    parser.add_argument("--job", type=Path)
    parser.add_argument("--loop", nargs="*", default=[], help="loops of the job, one after another; default: the first")
    parser.add_argument("--budget", action="store_true", help="show the budget of the line of sight")
    given = parser.parse_args()
    job = given.job or (CAMERA if given.budget else JOB)
    command = [sys.executable, "-m", "platform_ctrl", "serve", str(job), "--port", "0", "--no-browser", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        address = json.loads(process.stdout.readline())["address"]
        path = next(
            found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))
        )
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=path, args=list(FLAGS))
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.set_default_timeout(0)
            page.goto(address)
            page.wait_for_selector("body:not(.starting)", state="attached")
            talk = page.context.new_cdp_session(page)
            talk.send("Performance.enable")
            if given.budget:
                page.locator("#view label", has_text="Budget").click()
                page.wait_for_timeout(4000)
            for loop in given.loop or [None]:
                if loop is not None:
                    page.locator("#loop").select_option(loop)
                    while not page.evaluate("() => window.page.settled()"):
                        page.wait_for_timeout(200)
                    # The other parts of the job are measured then.
                    page.wait_for_timeout(5000)
                sliders = sliders_timed(page, process, given.rounds, given.budget)
            rows = []
            for part in range(4):
                if part:
                    for name in sliders[:3]:
                        page.evaluate(MOVE, [name, given.moves // 9, False])
                page.wait_for_timeout(1500)
                rows.append((part * (given.moves // 9) * 3, server_memory(process), page_memory(talk)))
                print(
                    f"after {rows[-1][0]:6d} moves: server {rows[-1][1]:7.1f} MB, page {rows[-1][2]:6.1f} MB",
                    flush=True,
                )
            browser.close()
    finally:
        process.terminate()
        process.wait(30.0)


if __name__ == "__main__":
    main()
