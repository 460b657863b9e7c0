"""The page in Chromium without a screen: `make test-browser`."""

import io
import shutil
import time

import numpy as np
import pytest

viser = pytest.importorskip("viser", reason="viser is not installed: pip install 'nilbs-geometry[view]'")
webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed: make test-browser installs it")
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
if not (CHROMIUM and DRIVER):
    pytest.skip("chromium and chromedriver are not installed", allow_module_level=True)

By = pytest.importorskip("selenium.webdriver.common.by").By

CONNECT = """const [address, protocol, done] = arguments, socket = new WebSocket(address, protocol);
socket.onopen = () => done("open");
socket.onclose = () => done("closed");"""
TABS = ("pose", "body", "cut", "rest", "meet", "save")


@pytest.fixture
def browser(request):
    """Opens pages; the errors that they print fail the test."""
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for word in ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"):
        options.add_argument(word)
    options.add_argument("--window-size=1100,850")
    options.add_argument("--lang=en-US")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


def waited(condition, seconds: float = 120.0):
    """What a condition returns as soon as it is true."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, f"nothing happened within {seconds:g} s"
        time.sleep(0.05)
    return found


def opened(browser, page):
    browser.get(page.address)
    waited(lambda: [tab for tab in browser.find_elements(By.CSS_SELECTOR, "[role=tab]") if tab.text in TABS])
    waited(page.server.get_clients)


def go_to(browser, name: str) -> None:
    next(tab for tab in browser.find_elements(By.CSS_SELECTOR, "[role=tab]") if tab.text == name).click()


def of_label(browser, text: str):
    """The input with a label."""
    label = next(e for e in browser.find_elements(By.XPATH, f"//label[normalize-space(text())='{text}']"))
    return label.find_element(By.XPATH, "./ancestor::*[.//input][1]").find_element(By.CSS_SELECTOR, "input")


def picture(browser) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB"))


def test_a_slider_of_the_page_poses_the_mesh(scene, pages, browser, near):
    page = pages(scene())
    opened(browser, page)
    before = np.array(page.skin.meshes[0].vertices)
    slider = browser.find_elements(By.CSS_SELECTOR, "[role=slider]")[2]
    browser.execute_script("arguments[0].focus()", slider)
    for _ in range(10):
        slider.send_keys("\ue014")  # right
    body = page.scene.bodies[0]
    waited(lambda: body.theta[0, 2] == pytest.approx(np.radians(5.0)))
    expected = body.character.skin(page.scene.shot().poses[0])
    waited(lambda: near(page.scene.frame.back(page.skin.meshes[0].vertices), expected, body.character.L))
    assert not near(page.scene.frame.back(before), expected, body.character.L)


def test_a_clip_plays_in_the_page(scene, pages, browser):
    page = pages(scene())
    opened(browser, page)
    button = next(e for e in browser.find_elements(By.CSS_SELECTOR, "button") if e.text == "play")
    button.click()
    waited(lambda: page.scene.player.playing and page.scene.player.time > 0)
    one = picture(browser)
    waited(lambda: (np.abs(picture(browser)[:, :600].astype(int) - one[:, :600]) > 50).any())
    next(e for e in browser.find_elements(By.CSS_SELECTOR, "button") if e.text == "pause").click()
    waited(lambda: not page.scene.player.playing)


def test_each_panel_shows_what_it_is_for(scene, pages, browser, tmp_path):
    page = pages(scene(points=np.random.default_rng(0).uniform(-1, 1, (50, 3))))
    opened(browser, page)
    for tab, label, text in (
        ("body", "surface of the field", "facets in"),
        ("cut", "cutting plane", "occupancy of hero"),
        ("meet", "contacts of a body with itself", "hero and itself"),
    ):
        go_to(browser, tab)
        browser.execute_script("arguments[0].click()", of_label(browser, label))
        waited(lambda text=text: text in browser.find_element(By.TAG_NAME, "body").text)
        browser.save_screenshot(str(tmp_path / f"{tab}.png"))
    # The plane has the colours of its values: outside, occupancy is 0.
    outside = np.array([68, 1, 84])
    shown = picture(browser).reshape(-1, 3).astype(int)
    assert (np.abs(shown - outside).max(axis=1) <= 3).mean() > 0.05


def test_a_page_of_another_site_cannot_talk_to_it(scene, pages, browser, tmp_path):
    page = pages(scene())
    (tmp_path / "evil.html").write_text("<title>evil</title>")
    browser.get((tmp_path / "evil.html").as_uri())
    address = f"ws://127.0.0.1:{page.server.get_port()}/"
    assert browser.execute_async_script(CONNECT, address, f"viser-v{viser.__version__}") == "closed"
    opened(browser, page)
    assert browser.execute_async_script(CONNECT, address, f"viser-v{viser.__version__}") == "open"
