"""Pages in a real browser, Chromium without a window; skipped where there is none."""

import shutil
from contextlib import suppress
from functools import partial

import pytest

from benchmarks.leaderboard.board import build
from benchmarks.site.pages import single_page, write_site
from discrepancy.report.answers import html_of
from discrepancy.report.pictures import Picture

selenium = pytest.importorskip("selenium", reason="pages are tried in a browser by selenium: pip install '.[test]'")

from selenium.common.exceptions import TimeoutException  # noqa: E402
from selenium.webdriver.support.ui import WebDriverWait  # noqa: E402

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
PHONE, DESKTOP = 390, 1280
"""Widths, px."""
LONG = "wheel_radius_" * 12
ANSWER = {
    "verdict": "named",
    "reason": LONG,
    "what": LONG,
    "probability": 0.9,
    "probabilities": {LONG: 0.9},
    "credible_set": [LONG],
    "same_as": [LONG],
    "effect": {"name": LONG},
    "size": 0.01,
    "unit": "m",
    "interval": [0.009, 0.011],
    "cost": [0.1, 0.1],
    "curve": None,
    "check": "Measure the wheel.",
    "separating_drive": None,
}
DIAGNOSIS = {
    "robot": "<script>alert(1)</script>",
    "verdict": "named",
    "preflight": [f"{LONG} counts backwards", "not whole numbers"],
    "mistakes": [{"what": LONG, "alternatives": [LONG]}],
    "answers": [ANSWER],
    "dimensions": [],
    "probabilities": {LONG: 0.9},
    "names": {LONG: LONG},
    "gap": [[0.01, 0.01], [0.001, 0.001]],
    "held_out_gap": [[0.01, 0.01], [0.001, 0.001]],
    "clean_gap": [0.001, 0.001],
    "noise": {"position_m": 1e-4, "heading_rad": 1e-4, "poses": 1000},
    "logs": [f"{LONG}/log.csv"],
    "held_out_logs": [],
    "clean_logs": [],
    "effects": [{"name": LONG}],
    "replay": None,
    "where": None,
}
"""Of a report with all that may be wide."""


@pytest.fixture(scope="module")
def browser():
    """Return a Chromium that logs all that it prints and all that it asks a network for."""
    if CHROMIUM is None or DRIVER is None:
        pytest.skip("there is no Chromium with its driver here (Debian: apt-get install chromium chromium-driver)")
    from selenium.webdriver import Chrome, ChromeOptions
    from selenium.webdriver.chrome.service import Service

    options = ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = Chrome(options=options, service=Service(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def site(results, tmp_path_factory):
    board = build([results.task], results.folder)
    out = tmp_path_factory.mktemp("site") / "site"
    write_site(board, results.folder, out)
    (out / "single.html").write_text(single_page(board), encoding="utf-8")
    drawn = '<svg xmlns="http://www.w3.org/2000/svg" width="900" height="90"><rect width="900" height="90"/></svg>'
    report = html_of(DIAGNOSIS, [Picture("drift", drawn, "a picture", "as far as it goes")])
    (out / "diagnosis.html").write_text(report, encoding="utf-8")
    return out


@pytest.fixture
def opened(browser, site):
    """Return a function that opens a page of the site at a width and in a colour scheme."""

    def open_page(name, width=DESKTOP, scheme="light"):
        metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width == PHONE}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
        browser.get((site / name).as_uri())
        return browser

    return open_page


def pages(site):
    return sorted(path.relative_to(site).as_posix() for path in site.rglob("*.html"))


def test_all_pages_can_be_made(site):
    """Without a browser, too."""
    assert {"index.html", "single.html", "diagnosis.html"} <= set(pages(site))


def test_no_page_complains_asks_a_network_or_runs_the_scripts_of_names(opened, browser, site):
    for log in ("browser", "performance"):
        browser.get_log(log)  # what is in it goes
    for name in pages(site):
        opened(name)
        assert browser.title
        assert browser.get_log("browser") == [], name  # an alert would raise, too
    events = [entry["message"] for entry in browser.get_log("performance")]
    asked = [event for event in events if '"Network.requestWillBeSent"' in event]
    assert len(asked) >= len(pages(site))
    assert not [event for event in asked if '"url":"file://' not in event and '"url":"data:' not in event]


@pytest.mark.parametrize("name", ["index.html", "single.html"])
def test_the_policy_stops_what_escaping_would_let_through(opened, browser, site, name):
    text = (site / name).read_text(encoding="utf-8")
    harmful = '<script>document.title = "ran"</script><img src="http://127.0.0.1:9/x.png" onerror="document.title = 1">'
    (site / "harmful.html").write_text(text.replace("<h1>", f"{harmful}<h1>"), encoding="utf-8")
    try:
        title = opened(name).title
        browser.get_log("browser")
        assert opened("harmful.html").title == title
        assert sum("Content Security Policy" in entry["message"] for entry in browser.get_log("browser")) >= 2
    finally:
        (site / "harmful.html").unlink()


def test_no_page_is_wider_than_a_phone(opened, browser, site):
    for name in pages(site):
        width = partial(opened(name, PHONE).execute_script, "return document.documentElement.scrollWidth")
        with suppress(TimeoutException):  # the first layout of a new page may still be as wide as its content
            WebDriverWait(browser, 10, poll_frequency=0.05).until(lambda _, width=width: width() <= PHONE)
        assert width() <= PHONE, name


def column(browser, k):
    return [row.find_elements("css selector", "td, th")[k].text for row in shown_rows(browser)]


def shown_rows(browser):
    return [row for row in browser.find_elements("css selector", "main tbody tr") if row.is_displayed()]


def test_columns_sort_both_ways_by_mouse_and_by_key(opened):
    browser = opened("tasks/arcs.html")
    heads = browser.find_elements("css selector", "thead th")
    (k,) = (k for k, head in enumerate(heads) if head.text.startswith("E_max,syst"))
    button = heads[k].find_element("css selector", "button")
    button.click()
    rising = [float(text) for text in column(browser, k)]
    assert heads[k].get_attribute("aria-sort") == "ascending"
    assert rising == sorted(rising)
    button.send_keys("\ue007")  # Enter
    assert heads[k].get_attribute("aria-sort") == "descending"
    assert [float(text) for text in column(browser, k)] == rising[::-1]
    heads[1].find_element("css selector", "button").click()
    names = column(browser, 1)
    assert names == sorted(names, key=str.casefold)
    assert heads[k].get_attribute("aria-sort") is None
    heads[0].find_element("css selector", "button").click()
    assert column(browser, 0)[-1] == "–"  # who has no rank is last, either way
    heads[0].find_element("css selector", "button").click()
    assert column(browser, 0)[-1] == "–"


def test_rows_are_filtered_and_counted(opened, stored_results):
    browser = opened("tasks/arcs.html")
    box = browser.find_element("css selector", "input[type=search]")
    box.send_keys("SCRIPT")
    assert column(browser, 1) == [stored_results.HOSTILE]
    assert browser.find_element("css selector", "output").text == f"1 of {len(stored_results.NAMES)} rows"
    box.clear()
    box.send_keys("g")
    box.send_keys("\ue003")  # Backspace
    assert len(column(browser, 1)) == len(stored_results.NAMES)


def test_a_hostile_row_leads_to_its_page(opened, stored_results):
    browser = opened("tasks/arcs.html")
    browser.find_element("link text", stored_results.HOSTILE).click()
    assert browser.find_element("css selector", "h1").text == stored_results.HOSTILE
    assert browser.find_elements("css selector", ".chart canvas")


def test_the_keyboard_reaches_content_sorting_and_maps(opened):
    browser = opened("tasks/arcs/good.html")
    browser.find_element("css selector", "body").send_keys("\ue004")  # Tab
    focused = browser.switch_to.active_element
    assert focused.text == "Skip to content"
    outline = "return getComputedStyle(document.activeElement).outlineStyle"
    assert browser.execute_script(outline) == "solid"
    map_of = browser.find_element("css selector", "svg.map")

    def box():
        return browser.execute_script("return arguments[0].getAttribute('viewBox')", map_of)

    before = box()
    map_of.send_keys("+")
    assert float(box().split()[2]) == pytest.approx(0.8 * float(before.split()[2]))
    map_of.send_keys("0")
    assert box() == before


def test_colours_follow_the_scheme_and_can_be_read(opened):
    """Contrast as WCAG 2.1 has it: at least 4.5 for text, also for the quieter one."""

    def luminance(color):
        linear = [(c / 255 / 12.92) if c / 255 <= 0.04045 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in color]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    grounds = []
    for scheme in ("light", "dark"):
        browser = opened("tasks/arcs.html", scheme=scheme)

        def color(selector, name, browser=browser):
            script = "return getComputedStyle(document.querySelector(arguments[0]))[arguments[1]]"
            text = browser.execute_script(script, selector, name)
            return [int(part) for part in text.partition("(")[2].rstrip(")").split(",")[:3]]

        grounds.append(luminance(color("body", "backgroundColor")))
        for selector in ("body", "caption", "thead th", "tbody th a", ".notes"):
            low, high = sorted((luminance(color(selector, "color")), grounds[-1]))
            assert (high + 0.05) / (low + 0.05) >= 4.5, (scheme, selector)
    assert grounds[0] > 0.8 > 0.1 > grounds[1]
