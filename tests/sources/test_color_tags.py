"""Tags that change colours: converted as other programs read them, or refused with the remedy."""

import json
import re
import struct
import zlib

import cv2
import numpy as np
import OpenImageIO
import pytest
from PIL import Image, ImageCms
from support.pictured import AT, FACES, face, run, seen

import omniscv
from omniscv.errors import ArgumentError
from omniscv.geometry import Pose
from omniscv.sources.pictures import DepthForm, read_picture

CODES = np.random.default_rng(3).integers(0, 256, (16, 32, 3), np.uint8)


def light_of(codes):
    """IEC 61966-2-1."""
    v = codes / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def codes_of(light):
    x = np.clip(light, 0, 1)
    return 255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def png(path, pixels, **chunks):
    """A PNG with chunks behind its header."""
    Image.fromarray(pixels).save(path)
    data = path.read_bytes()
    more = b"".join(
        struct.pack(">I", len(body))
        + name.encode()
        + body
        + struct.pack(">I", zlib.crc32(name.encode() + body))
        for name, body in chunks.items()
    )
    path.write_bytes(data[:33] + more + data[33:])


LINEAR = np.uint8(np.round(255 * light_of(CODES)))
P3_TO_709 = [[1.2249, -0.2247, 0], [-0.0420, 1.0419, 0], [-0.0197, -0.0786, 1.0979]]  # of Display P3, D65
GAMMAS = [
    ({"gAMA": struct.pack(">I", 100_000)}, codes_of(LINEAR / 255)),
    ({"cICP": bytes([1, 8, 0, 1])}, codes_of(LINEAR / 255)),
    ({"gAMA": struct.pack(">I", 55_556)}, codes_of((LINEAR / 255) ** 1.8)),
    ({"cICP": bytes([12, 13, 0, 1])}, codes_of(light_of(LINEAR) @ np.transpose(P3_TO_709))),
    ({"gAMA": struct.pack(">I", 45_455)}, LINEAR),
    ({"sRGB": b"\0", "gAMA": struct.pack(">I", 100_000)}, LINEAR),
    ({"cICP": bytes([1, 13, 0, 1]), "gAMA": struct.pack(">I", 100_000)}, LINEAR),
]


@pytest.mark.parametrize(("chunks", "expected"), GAMMAS, ids=[" ".join(chunks) for chunks, _ in GAMMAS])
def test_curves_and_primaries_of_png(chunks, expected, tmp_path):
    png(tmp_path / "a.png", LINEAR, **chunks)
    picture = read_picture(tmp_path / "a.png")
    assert picture.pixels.dtype == np.uint8
    assert np.abs(picture.pixels - expected).max() <= 1.3
    assert bool(picture.lines) == (not np.array_equal(picture.pixels, LINEAR))


@pytest.mark.parametrize("cicp", [(9, 16, 0, 1), (9, 18, 0, 1), (1, 1, 0, 1), (1, 13, 0, 0), (11, 13, 0, 1)])
def test_curves_without_an_exact_meaning_are_refused(cicp, tmp_path):
    png(tmp_path / "a.png", CODES, cICP=bytes(cicp))
    with pytest.raises(ArgumentError, match=r"expected colours in sRGB, got cICP .*--transfer srgb takes"):
        read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png", as_codes=True).pixels, CODES)


def profile(primaries, white=(0.3127, 0.329), gamma=2.2):
    """An ICC profile of a matrix and a power, in bytes."""
    M = xyz_of(primaries, white)
    cones = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    d50 = np.array([0.9642, 1.0, 0.8249])
    adapted = np.linalg.inv(cones) @ np.diag((cones @ d50) / (cones @ M.sum(axis=1))) @ cones @ M
    number = lambda v: struct.pack(">i", round(v * 65536))  # noqa: E731
    xyz = lambda v: b"XYZ \0\0\0\0" + b"".join(map(number, v))  # noqa: E731
    curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(gamma * 256)) + b"\0\0"
    text = b"Mine"
    described = b"desc\0\0\0\0" + struct.pack(">I", len(text) + 1) + text + b"\0" + bytes(78)
    described += bytes(-len(described) % 4)
    tags = {b"desc": described, b"wtpt": xyz(d50), b"cprt": b"text\0\0\0\0none\0\0\0\0"}
    tags |= {name: xyz(adapted[:, i]) for i, name in enumerate((b"rXYZ", b"gXYZ", b"bXYZ"))}
    tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve)
    at = 128 + 4 + 12 * len(tags)
    table = b""
    body = b""
    for name, data in tags.items():
        table += name + struct.pack(">II", at + len(body), len(data))
        body += data
    size = at + len(body)
    head = struct.pack(">I4sI4s4s4s", size, b"lcms", 0x02400000, b"mntr", b"RGB ", b"XYZ ") + bytes(12)
    head += b"acsp" + bytes(28) + b"".join(map(number, d50)) + bytes(48)
    return head[:128] + struct.pack(">I", len(tags)) + table + body


def xyz_of(primaries, white):
    columns = np.array([[x / y, 1, (1 - x - y) / y] for x, y in primaries]).T
    x, y = white
    return columns * np.linalg.solve(columns, [x / y, 1, (1 - x - y) / y])


ADOBE = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06))
REC_709 = ((0.64, 0.33), (0.3, 0.6), (0.15, 0.06))
D65 = (0.3127, 0.329)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "webp"])
def test_icc_profiles(suffix, tmp_path):
    options = {"jpg": {"quality": 100, "subsampling": 0}, "webp": {"lossless": True}}.get(suffix, {})
    smooth = cv2.resize(CODES, (64, 32))
    Image.fromarray(smooth).save(tmp_path / f"a.{suffix}", icc_profile=profile(ADOBE), **options)
    shown = (smooth / 255) ** 2.2 @ (np.linalg.inv(xyz_of(REC_709, D65)) @ xyz_of(ADOBE, D65)).T
    picture = read_picture(tmp_path / f"a.{suffix}")
    inside = ((shown > 0.02) & (shown < 0.98)).all(axis=-1)  # of sRGB
    off = np.abs(picture.pixels - codes_of(shown))[inside]
    assert np.percentile(off, 99) <= (4 if suffix == "jpg" else 1.6)
    assert np.abs(smooth - codes_of(shown))[inside].mean() > 5
    assert "colours are converted by the ICC profile 'Mine'" in picture.lines[0]


def test_a_profile_of_srgb_changes_nothing(tmp_path):
    of_srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(CODES).save(tmp_path / "a.png", icc_profile=of_srgb)
    picture = read_picture(tmp_path / "a.png")
    assert picture.payload == (tmp_path / "a.png").read_bytes()
    assert not picture.lines


def test_a_profile_that_is_none_is_refused(tmp_path):
    Image.fromarray(CODES).save(tmp_path / "a.jpg", icc_profile=b"no profile" * 20)
    with pytest.raises(ArgumentError, match="expected an ICC profile that converts to sRGB"):
        read_picture(tmp_path / "a.jpg")


ACES_CG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
ACES_CG_TO_709 = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
"""As colour programs have it."""


def test_chromaticities_of_exr(tmp_path):
    light = light_of(CODES).astype(np.float32)
    stored = light @ np.linalg.inv(ACES_CG_TO_709).T.astype(np.float32)
    spec = OpenImageIO.ImageSpec(32, 16, 3, "half")
    spec.attribute("chromaticities", "float[8]", ACES_CG)
    output = OpenImageIO.ImageOutput.create(str(tmp_path / "a.exr"))
    assert output.open(str(tmp_path / "a.exr"), spec)
    assert output.write_image(np.ascontiguousarray(stored))
    output.close()
    picture = read_picture(tmp_path / "a.exr")
    np.testing.assert_allclose(picture.pixels, light, atol=3e-3)
    assert np.abs(stored - light).max() > 0.2
    assert picture.lines == ("colours are converted by chromaticities",)


def written_by_openimageio(path, pixels, kind, **attributes):
    """Write colours with attributes of the library's description of a picture."""
    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], 3, kind)
    for name, value in attributes.items():
        spec.attribute(name.replace("_", ":"), value)
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(np.ascontiguousarray(pixels))
    output.close()


@pytest.mark.parametrize("gamma", [None, 1.0, 2.2])
def test_gammas_of_tga_that_leave_codes_as_they_are(gamma, tmp_path):
    written_by_openimageio(
        tmp_path / "a.tga", CODES, "uint8", **({} if gamma is None else {"oiio_Gamma": gamma})
    )
    picture = read_picture(tmp_path / "a.tga")
    np.testing.assert_array_equal(picture.pixels, CODES)
    assert not picture.lines


@pytest.mark.parametrize("gamma", [0.5, 1.8, 2.4])
def test_other_gammas_of_tga_are_refused(gamma, tmp_path):
    written_by_openimageio(tmp_path / "a.tga", CODES, "uint8", oiio_Gamma=gamma)
    says = f"got a gamma of {gamma:g}; convert the picture, or --transfer srgb takes its codes as they are"
    with pytest.raises(ArgumentError, match=re.escape(says)):
        read_picture(tmp_path / "a.tga")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tga", as_codes=True).pixels, CODES)


def test_light_of_half_floats_in_tiff(tmp_path):
    light = 4 * light_of(CODES).astype(np.float32)
    written_by_openimageio(tmp_path / "a.tif", light, "half", tiff_half=1)
    assert (tmp_path / "a.tif").stat().st_size < 32 * 16 * 3 * 4, "halves, not floats"
    picture = read_picture(tmp_path / "a.tif")
    np.testing.assert_array_equal(picture.pixels, light.astype(np.float16).astype(np.float32))


@pytest.mark.parametrize(("header", "gain"), [("EXPOSURE=4", 4), ("EXPOSURE= 2\nEXPOSURE=0.25", 0.5)])
def test_exposure_of_radiance(header, gain, tmp_path):
    light = light_of(CODES).astype(np.float32)
    cv2.imwrite(str(tmp_path / "a.hdr"), light[..., ::-1] * gain)
    data = (tmp_path / "a.hdr").read_bytes()
    (tmp_path / "a.hdr").write_bytes(data.replace(b"FORMAT=", header.encode() + b"\nFORMAT=", 1))
    np.testing.assert_allclose(read_picture(tmp_path / "a.hdr").pixels, light, rtol=0.02, atol=0.02)


def test_radiance_of_xyz_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "a.hdr"), light_of(CODES).astype(np.float32))
    data = (tmp_path / "a.hdr").read_bytes()
    (tmp_path / "a.hdr").write_bytes(data.replace(b"rle_rgbe", b"rle_xyze", 1))
    with pytest.raises(ArgumentError, match=r"expected light of Rec\. 709, got FORMAT|expected a"):
        read_picture(tmp_path / "a.hdr")


def white_is_zero(path, pixels):
    """A grey TIFF whose greatest number is black."""
    Image.fromarray(np.iinfo(pixels.dtype).max - pixels).save(path)
    data = bytearray(path.read_bytes())
    (start,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, start)
    for entry in range(start + 2, start + 2 + 12 * count, 12):
        if struct.unpack_from("<H", data, entry)[0] == 262:
            struct.pack_into("<H", data, entry + 8, 0)
    path.write_bytes(data)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tiff_whose_zero_is_white(dtype, tmp_path):
    stored = CODES[..., 0].astype(dtype) * (257 if dtype == np.uint16 else 1)
    white_is_zero(tmp_path / "a.tif", stored)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif", "object_mask").pixels, stored)
    if dtype == np.uint16:
        white_is_zero(tmp_path / "d.tif", np.full((4, 8), 2000, np.uint16))
        depth = read_picture(tmp_path / "d.tif", "depth", DepthForm.parse("planar-mm")).pixels
        np.testing.assert_allclose(depth, 2.0)


def test_bytes_behind_a_jpeg_are_ignored_and_said(tmp_path, capsys):
    """Phones append a video, whose bytes look like markers."""
    appended = (
        np.random.default_rng(0).integers(0, 256, 200_000, np.uint8).tobytes() + b"\xff\xda\xff\xc2\0\x11"
    )
    for name, view in ((word, face(Pose.from_angles(AT), word, 32)) for word in FACES):
        path = tmp_path / f"f/{name}.jpg"
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(seen(view)[0]).save(path, quality=95)
        path.write_bytes(path.read_bytes() + appended)
    assert run(tmp_path / "f", tmp_path / "a.sqlite") == 0
    assert f"{len(appended)} bytes behind the picture are ignored (6 files)" in capsys.readouterr().out
    cut = tmp_path / "cut.jpg"
    cut.write_bytes((tmp_path / "f/front.jpg").read_bytes()[:300])
    with pytest.raises(ArgumentError, match="a JPEG without its end"):
        read_picture(cut)


def test_a_turned_picture_is_refused_with_the_remedy(tmp_path):
    turned = Image.Exif()
    turned[0x0112] = 6
    Image.fromarray(CODES).save(tmp_path / "a.jpg", exif=turned)
    with pytest.raises(ArgumentError, match="in its EXIF; turn its pixels, as 'mogrify -auto-orient' does"):
        read_picture(tmp_path / "a.jpg")


@pytest.mark.parametrize(
    ("words", "chunks", "transfer"),
    [
        ((), {}, "srgb"),
        ((), {"gAMA": struct.pack(">I", 100_000)}, "srgb"),
        (("--transfer", "linear"), {"gAMA": struct.pack(">I", 45_455)}, "linear"),
        (("--transfer", "unknown"), {}, "unknown"),
    ],
)
def test_imported_colours_state_their_transfer(words, chunks, transfer, tmp_path):
    (tmp_path / "f").mkdir()
    png(tmp_path / "f/pano.png", CODES, **chunks)
    assert run(tmp_path / "f", tmp_path / "a.sqlite", *words) == 0
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        assert source.capabilities.transfer == transfer


def test_a_folder_of_captures_states_it_too_and_converts(tmp_path):
    """Colours are; those of a mask are names of objects, whatever its tags say."""
    (tmp_path / "f").mkdir()
    png(tmp_path / "f/a.png", LINEAR, gAMA=struct.pack(">I", 100_000))
    png(tmp_path / "f/m.png", LINEAR, gAMA=struct.pack(">I", 100_000))
    view = {"position": [0, 0, 1], "fov_deg": 90, "width": 32, "height": 16}
    files = {"lit": "a.png", "object_mask": "m.png"}
    entries = [{"file": file, "mode": mode, "view": view} for mode, file in files.items()]
    (tmp_path / "f/captures.json").write_text(json.dumps(entries))
    assert run(tmp_path / "f", tmp_path / "a.sqlite") == 0
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        assert source.capabilities.transfer == "srgb"
        (seen_view,) = source.recorded_views()
        lit, mask = source.capture([omniscv.sources.Request(seen_view, mode) for mode in files])
    assert np.abs(lit.pixels - codes_of(LINEAR / 255)).max() <= 0.8
    np.testing.assert_array_equal(mask.pixels, LINEAR)
    assert "transfer" not in mask.provenance


def test_edges_of_imported_pictures_are_means_of_light(tmp_path):
    """Stripes of black and white, finer than the image's pixels: half of the light is code 188."""
    stripes = np.repeat(np.uint8(np.arange(512) % 2 * 255)[None, :, None], 256, axis=0).repeat(3, axis=2)
    (tmp_path / "f").mkdir()
    Image.fromarray(stripes).save(tmp_path / "f/pano.png")
    assert run(tmp_path / "f", tmp_path / "a.sqlite") == 0
    camera = omniscv.cameras.create("equirectangular", 32, 16)
    with omniscv.open_source(tmp_path / "a.sqlite") as source:
        image = omniscv.render(camera, Pose.from_angles((0, 0, 0)), source, ("lit",), filter="area")
    assert abs(np.median(image.lit.astype(float)) - 188) < 12
