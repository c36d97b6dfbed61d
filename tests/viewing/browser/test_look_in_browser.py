"""The page of ``omniscv look`` in a real browser, against the traced scene."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from support import browser, looked

from omniscv.geometry import Pose
from omniscv.viewing.look import look

# Ten directions, yaw and pitch in degrees; the mirror's camera sees what is behind it.
DIRECTIONS = (
    (25, 0), (0, 0), (60, -20), (-40, 10), (25, -45), (90, 0), (-20, -30), (50, 30), (110, -10), (10, 20),
)  # fmt: skip
BEHIND = {"mirror": 180}
SEEN_AT_LEAST = {"panorama": 10, "fisheye": 10, "mirror": 7}

DRAWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
COLOR = """(x) => {
  const gl = document.getElementById("gl").getContext("webgl2"), color = new Uint8Array(4);
  const place = [x * gl.drawingBufferWidth, gl.drawingBufferHeight / 2];
  gl.readPixels(...place, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, color);
  return `rgb(${color.slice(0, 3).join(", ")})`;
}"""
READ = f"""async ([frame, layer, directions]) => {{
  const found = [], color = {COLOR}, title = document.getElementById("subtitle");
  for (const [yaw, pitch] of directions) {{
    const changed = new Promise((done) => addEventListener("hashchange", done, {{ once: true }}));
    location.hash = new URLSearchParams({{ frame, layer, yaw, pitch, fov: 40 }});
    await changed;
    while (!title.textContent.startsWith(frame)) await {DRAWN};
    await {DRAWN};
    const shown = document.querySelector("#values .swatch")?.style.background;
    found.push({{ ...document.getElementById("reading").dataset, color: color(0.5), shown }});
  }}
  return found;
}}"""


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """A page of images in a browser, with all that it requested and printed."""
    folder = tmp_path_factory.mktemp("look")
    truth = looked.images(folder / "images")
    name = folder / "images" / "objects.json"
    objects = json.loads(name.read_text())
    hostile = "</script><img src=x onerror=alert(1)>"
    objects["900"] = {"name": hostile, "mask_color": [1, 2, 3]}
    name.write_text(json.dumps(objects))
    page_file, *_ = look(folder / "images", folder / "look.html")
    beside, *files = look(folder / "images", folder / "beside.html", most_pixels=0)
    requested = []
    printed = []
    with browser.started() as chromium:
        context = chromium.new_context(viewport={"width": 780, "height": 330}, has_touch=True)
        page = context.new_page()
        page.on("request", lambda request: requested.append(request.url))
        page.on("console", lambda message: printed.append(message.text))
        page.on("pageerror", lambda error: printed.append(str(error)))
        page.goto(page_file.as_uri())
        page.wait_for_selector("html[data-ready]")
        yield SimpleNamespace(
            page=page,
            truth=truth,
            requested=requested,
            printed=printed,
            hostile=hostile,
            beside=beside,
            files=files,
        )


def reading(page):
    return page.evaluate("({...document.getElementById('reading').dataset})")


def pixel_of(read):
    return [int(each) for each in read["pixel"].split(",")]


def layer(page):
    return page.locator("#layers [aria-checked=true]").evaluate("each => each.firstChild.textContent")


@pytest.mark.parametrize("stem", looked.CAMERAS)
def test_ten_directions_show_what_is_there(shown, stem):
    """Asked for a direction, the page reads a pixel whose ray is within a pixel of it, and shows that ray's
    object and distance as they are traced; the picture has the colour of the list."""
    camera = looked.CAMERAS[stem]
    directions = [(yaw + BEHIND.get(stem, 0), pitch) for yaw, pitch in DIRECTIONS]
    found = shown.page.evaluate(READ, [stem, "labels", directions])
    steps = np.linalg.norm(np.diff(camera.unproject().directions, axis=1), axis=-1)
    density = np.nanmedian(1 / steps[camera.valid()[:, 1:]])
    seen = 0
    for (yaw, pitch), read in zip(directions, found, strict=True):
        wanted = looked.POSE.R_w_c.T @ Pose.from_angles((0, 0, 0), yaw, pitch).R_w_c[:, 2]
        _, sees = camera.project(1e6 * wanted)
        assert sees == (read["pixel"] != "")
        if not sees:
            continue
        seen += 1
        pixel = pixel_of(read)
        ray = camera.unproject(np.array(pixel) + 0.5).directions
        assert np.linalg.norm(ray - wanted) * density < 1.5
        hit = shown.truth.trace(camera, pixel)
        assert int(read["label"]) == hit.label[0] == shown.truth.scene.label(read["name"])
        assert float(read["metres"]) == np.float32(hit.distance[0])
        assert read["color"] == read["shown"]
    assert seen >= SEEN_AT_LEAST[stem]


def test_keys_change_layers_form_frame_and_direction(shown):
    """Where the image is not mirrored, what is right has the larger column."""
    page = shown.page
    subtitle = page.inner_text("#subtitle")
    page.keyboard.press("n")
    page.wait_for_function("was => document.getElementById('subtitle').textContent !== was", arg=subtitle)
    page.keyboard.press("1")
    assert layer(page) == "Colour"
    page.keyboard.press("3")
    assert layer(page) == "Depth"
    assert page.is_visible("#scale")
    page.keyboard.press("0")
    before = reading(page)["pixel"]
    page.keyboard.press("ArrowRight")
    assert int(reading(page)["pixel"].split(",")[0]) > int(before.split(",")[0])
    page.keyboard.press("f")
    assert page.get_attribute("#flat", "aria-pressed") == "true"
    page.keyboard.press("f")
    assert page.get_attribute("#sphere", "aria-pressed") == "true"


def test_a_divider_shows_two_layers(shown):
    page = shown.page
    page.keyboard.press("2")
    page.select_option("#compare", "slider")
    box = page.locator("#stage").bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] / 2, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 4, middle)
    page.mouse.up()
    page.evaluate(DRAWN)
    found = [page.evaluate(COLOR, x) for x in (0.2, 0.3)]
    listed = page.eval_on_selector_all("#objects .swatch", "all => all.map((each) => each.style.background)")
    assert found[0] in listed
    assert found[1] not in listed
    page.select_option("#compare", "off")


def test_a_touch_reads_a_place_and_a_drag_turns(shown):
    page = shown.page
    page.keyboard.press("0")
    box = page.locator("#stage").bounding_box()
    before = reading(page)["pixel"]
    page.touchscreen.tap(box["x"] + 30, box["y"] + box["height"] / 2)
    assert reading(page)["pixel"] != before
    page.keyboard.press("Escape")
    assert reading(page)["pixel"] == before
    page.mouse.move(box["x"] + 200, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 260, box["y"] + 100, steps=3)
    page.mouse.up()
    page.keyboard.press("Escape")
    assert reading(page)["pixel"] != before


def test_a_name_is_text_whatever_is_in_it(shown):
    names = shown.page.eval_on_selector_all("#objects span", "all => all.map((each) => each.textContent)")
    assert shown.hostile in names


def test_frames_beside_the_page_are_loaded_when_they_are_shown(shown):
    page = shown.page
    page.goto(f"{shown.beside.as_uri()}#frame=fisheye")
    page.wait_for_selector("html[data-ready]")
    assert page.inner_text("#subtitle").startswith("fisheye")
    assert shown.files[0].as_uri() in shown.requested
    hit = shown.truth.trace(looked.CAMERAS["fisheye"], pixel_of(reading(page)))
    assert float(reading(page)["metres"]) == np.float32(hit.distance[0])


def test_nothing_is_requested_from_a_network_and_nothing_goes_wrong(shown):
    assert {url.split(":")[0] for url in shown.requested} <= {"file", "data", "blob"}
    assert shown.printed == []
