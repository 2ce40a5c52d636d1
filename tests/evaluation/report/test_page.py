"""The page of a comparison in headless Chromium, from a file, without a network."""

import os
import shutil
from dataclasses import replace

import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.evaluation import ComparisonRequest, SceneSubject, compare
from photonrelax.evaluation.reference import ABOUT, Reference
from photonrelax.evaluation.report import folder

SIZE = 48
CHROMIUM = shutil.which("chromium"), shutil.which("chromedriver")
FLAGS = [
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--disable-dev-shm-usage", "--window-size=1200,1400"),
]
# Where the whole suite has to run, a browser that is missing is a failure.
pytestmark = pytest.mark.skipif(
    not all(CHROMIUM) and not os.environ.get("CI"), reason="chromium and chromium-driver are absent"
)


@pytest.fixture(scope="module")
def comparison():
    scene = gallery.scene("ring", pixels=SIZE, sections=128)
    reference = pr.render(scene, method="standard", n_emitted=50_000, seed=1, supersampling=1)
    comparison_request = ComparisonRequest(
        subject=SceneSubject(scene),
        methods=("standard", "mapped"),
        n_emitted=5000,
        supersampling=1,
    )
    return compare(comparison_request, reference)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    from selenium import webdriver

    assert all(CHROMIUM), "chromium and chromium-driver should be installed"
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM[0]
    for flag in [*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"]:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(CHROMIUM[1]))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def written(comparison, tmp_path_factory):
    path = tmp_path_factory.mktemp("page")
    return path, folder.write(comparison, path)


@pytest.fixture
def page(browser, written):
    browser.get((written[0] / "index.html").as_uri())
    yield browser
    assert browser.get_log("browser") == []


def find(page, selector):
    return page.find_element("css selector", selector)


def value_of(page, script):
    return page.execute_script(f"return {script}")


def choose(page, side, method):
    from selenium.webdriver.support.select import Select

    Select(find(page, f"#{side}-method")).select_by_value(method)


def source(page, side):
    return find(page, f"#{side}").get_attribute("src")


def test_every_image_loads(page):
    widths = value_of(page, "[...document.images].map((image) => image.naturalWidth)")
    assert widths == [SIZE] * 5
    assert "ring" in page.title
    assert find(page, "h1").text == "ring: 2 methods side by side"


def test_the_slider_starts_in_the_middle_and_follows_the_pointer(page):
    from selenium.webdriver.common.action_chains import ActionChains

    stage = find(page, "#stage")
    assert "50%" in stage.get_attribute("style")
    quarter = -stage.size["width"] // 4
    drag = ActionChains(page).move_to_element(stage).click_and_hold()
    drag.move_to_element_with_offset(stage, quarter, 0).release().perform()
    assert float(find(page, "#split").get_attribute("value")) == pytest.approx(25, abs=1)
    left = value_of(page, "getComputedStyle(document.getElementById('right')).clipPath")
    assert left == "inset(0px 0px 0px 25%)"


def test_the_slider_follows_the_keys(page):
    from selenium.webdriver.common.keys import Keys

    slider = find(page, "#split")
    slider.send_keys(Keys.HOME, *[Keys.ARROW_RIGHT] * 3)
    assert find(page, "#stage").get_attribute("style") == "--split: 3%;"
    slider.send_keys(Keys.END)
    assert slider.get_attribute("aria-valuetext") == "100 percent"


def test_all_controls_are_reached_by_the_keyboard(page):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    reached = []
    for _ in range(5):
        ActionChains(page).send_keys(Keys.TAB).perform()
        active = page.switch_to.active_element
        reached.append(
            active.get_attribute("id") or active.get_attribute("name") or active.tag_name
        )
    assert reached == ["left-method", "right-method", "kind", "split", "summary"]


def test_any_two_methods_stand_side_by_side(page):
    assert source(page, "left") != source(page, "right")
    choose(page, "left", "mapped")
    assert source(page, "left") == source(page, "right")
    choose(page, "right", "reference")
    assert find(page, "#right-tag").text == "reference"
    assert find(page, "#left-tag").text.startswith("mapped: SSIM 0.")
    assert find(page, "#left").get_attribute("alt") == "mapped, image"


@pytest.mark.parametrize("kind", ["flip", "difference"])
def test_error_maps_come_and_go(page, kind):
    before = source(page, "left")
    value_of(page, f"document.querySelector('[value={kind}]').focus()")
    find(page, f"[value={kind}]").send_keys(" ")
    assert source(page, "left") != before
    assert value_of(page, "document.getElementById('left').decode().then(() => true)")
    assert find(page, "#left").get_attribute("alt") == f"standard, {kind}"
    find(page, "[value=image]").send_keys(" ")
    assert source(page, "left") == before


def test_the_reference_has_no_error_map_and_shows_itself(page):
    choose(page, "left", "reference")
    before = source(page, "left")
    find(page, "[value=flip]").send_keys(" ")
    assert source(page, "left") == before
    assert find(page, "#left-tag").text == "reference: the image itself"


def test_two_images_are_seen_at_first_whatever_was_compared(browser, comparison, tmp_path):
    (entry,) = (e for e in comparison.entries if e.method == "mapped")
    folder.write(replace(comparison, entries=(entry,)), tmp_path)
    browser.get((tmp_path / "index.html").as_uri())
    assert find(browser, "#left-method").get_attribute("value") == "reference"
    assert source(browser, "left") != source(browser, "right")
    assert find(browser, "h1").text == "ring: 1 method and the reference side by side"


def test_words_that_look_like_the_end_of_the_data_do_no_harm(browser, comparison, tmp_path):
    words = "</script><script>document.title = 'broken'</script>"
    layers = comparison.reference.image.layers
    reference = Reference(pr.Image(layers, {ABOUT: words}), comparison.entries[0].image.layers, 0.0)
    folder.write(replace(comparison, reference=reference), tmp_path)
    browser.get((tmp_path / "index.html").as_uri())
    assert "broken" not in browser.title
    notes = [note.text for note in browser.find_elements("css selector", "#notes p")]
    assert f"reference: {words}" in notes


def test_the_table_is_the_one_that_is_printed(page, written):
    table = written[1]
    head = [cell.text for cell in page.find_elements("css selector", "#table thead th")]
    assert head == table.column_titles
    rows = page.find_elements("css selector", "#table tbody tr")
    shown = [[cell.text for cell in row.find_elements("css selector", "th, td")] for row in rows]
    assert shown == [[name, *cells] for name, cells, _ in table.rows]
    marked = [cell.text for cell in page.find_elements("css selector", "td.best")]
    assert marked == [cells[best] for _, cells, best in table.rows if best is not None]
    assert [note.text for note in page.find_elements("css selector", "#notes p")] == table.notes


def test_settings_are_on_the_page(page):
    find(page, "summary").click()
    assert '"n_emitted": 5000' in find(page, "#settings").text


def test_a_narrow_window_does_not_overflow(page):
    page.set_window_size(500, 900)
    assert value_of(page, "document.documentElement.scrollWidth <= innerWidth")
    page.set_window_size(1200, 1400)
