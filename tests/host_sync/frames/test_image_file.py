"""Varieties of image files that cameras and their programs write: read as what they show, or refused by name."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from device.imaging.flat_field import demosaic
from hal.frame import CameraSettings, RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSpec
from host_sync.frames.image_file import read_image, read_info
from host_sync.frames.image_info import exif_orientation, shape_upright, upright
from host_sync.frames.linear_light import read_frame

SHAPE = (48, 64)


def colours(dtype: type = np.uint8, bits: int | None = None) -> np.ndarray:
    highest = (1 << bits) - 1 if bits else np.iinfo(dtype).max
    return np.random.default_rng(5).integers(0, highest + 1, (*SHAPE, 3)).astype(dtype)


def greys() -> np.ndarray:
    return colours()[..., 0]


def encoded(image: Image.Image, kind: str, **options: object) -> bytes:
    stream = BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def png_with(chunk: bytes, data: bytes, png: bytes) -> bytes:
    """The PNG with one more chunk after its header."""
    whole = struct.pack(">I", len(data)) + chunk + data + struct.pack(">I", zlib.crc32(chunk + data))
    return png[:33] + whole + png[33:]


def palette_of(image: np.ndarray) -> Image.Image:
    return Image.fromarray(image).convert("P", palette=Image.Palette.ADAPTIVE)


def read(path: Path) -> np.ndarray:
    info, pixels = read_info(path), read_image(path)
    assert not isinstance(pixels, RawFrame)
    assert info.shape == pixels.shape[:2]
    assert info.channels == (3 if pixels.ndim == 3 else 1)
    return pixels


def saved(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: encoded(palette_of(colours()), "PNG"), np.asarray(palette_of(colours()).convert("RGB"))),
        (lambda: encoded(palette_of(colours()).quantize(16), "PNG", bits=4), None),
        (lambda: encoded(Image.fromarray(greys()).convert("P"), "PNG"), greys()),
        (lambda: encoded(Image.fromarray(colours()).convert("RGBA"), "PNG"), colours()),
        (lambda: encoded(Image.fromarray(greys()).convert("LA"), "PNG"), greys()),
        (lambda: encoded(Image.fromarray(colours()), "PNG") + b"after the end", colours()),
        (lambda: png_with(b"gAMA", struct.pack(">I", 45455), encoded(Image.fromarray(colours()), "PNG")), colours()),
    ],
)
def test_a_png_of_any_colour_type_shows_its_colours(
    tmp_path: Path, make: Callable[[], bytes], expected: np.ndarray | None
) -> None:
    pixels = read(saved(tmp_path / "frame.png", make()))
    assert expected is None or np.array_equal(pixels, expected)
    assert pixels.dtype == np.uint8


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
def test_transparent_pixels_are_refused_by_name(tmp_path: Path, mode: str) -> None:
    image = Image.fromarray(colours()).convert(mode)
    image.putpixel((3, 3), (9, 9, 9, 0)[-len(mode) :])
    path = saved(tmp_path / "frame.png", encoded(image, "PNG"))
    for reads in (read_info, read_image):
        with pytest.raises(FrameSetError, match=r"frame\.png: has transparent pixels"):
            reads(path)
    path = saved(tmp_path / "key.png", encoded(Image.fromarray(greys()), "PNG", transparency=int(greys()[0, 0])))
    with pytest.raises(FrameSetError, match="has transparent pixels"):
        read_info(path)


def tiff(path: Path, pixels: np.ndarray, **options: object) -> Path:
    tifffile.imwrite(path, pixels, **options)
    return path


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", [None, "zlib", "lzw"])
def test_a_planar_tiff_is_an_rgb_image(tmp_path: Path, dtype: type, compression: str | None) -> None:
    planes = np.moveaxis(colours(dtype), -1, 0)
    path = tiff(tmp_path / "p.tif", planes, photometric="rgb", planarconfig="separate", compression=compression)
    assert np.array_equal(read(path), colours(dtype))


def test_a_tiff_of_greys_from_white_shows_light(tmp_path: Path) -> None:
    path = tiff(tmp_path / "white.tif", 255 - greys(), photometric="miniswhite")
    assert np.array_equal(read(path), greys())


def test_a_palette_in_a_tiff_shows_its_colours(tmp_path: Path) -> None:
    palette = np.random.default_rng(1).integers(0, 256, (3, 256)).astype(np.uint16)
    path = tiff(tmp_path / "p.tif", greys(), photometric="palette", colormap=palette * 257)
    assert np.array_equal(read(path), palette.T[greys()])


def test_an_opacity_in_a_tiff_is_dropped_where_all_is_opaque(tmp_path: Path) -> None:
    rgba = np.dstack([colours(), np.full(SHAPE, 255, np.uint8)])
    options = {"photometric": "rgb", "extrasamples": ["unassalpha"]}
    assert np.array_equal(read(tiff(tmp_path / "a.tif", rgba, **options)), colours())
    rgba[4, 4, 3] = 7
    with pytest.raises(FrameSetError, match="has transparent pixels"):
        read_info(tiff(tmp_path / "a.tif", rgba, **options))


@pytest.mark.parametrize("bits", [9, 10, 12, 14])
def test_packed_counts_say_their_full_scale(tmp_path: Path, bits: int) -> None:
    path = tmp_path / "packed.tif"
    packed = imagecodecs.packints_encode(colours(np.uint16, bits), bits)
    width = SHAPE[1] * 3 * bits
    assert width % 8 == 0
    write_packed(path, packed, bits)
    assert read_info(path).full_scale == (1 << bits) - 1
    assert np.array_equal(read(path), colours(np.uint16, bits))


def write_packed(path: Path, packed: bytes, bits: int) -> None:
    """A TIFF of one strip whose samples are `bits` wide; tifffile writes none."""
    entries = [(256, 4, 1, SHAPE[1]), (257, 4, 1, SHAPE[0]), (258, 3, 3, 0), (259, 3, 1, 1), (262, 3, 1, 2)]
    entries += [(273, 4, 1, 0), (277, 3, 1, 3), (278, 4, 1, SHAPE[0]), (279, 4, 1, len(packed)), (284, 3, 1, 1)]
    end = 8 + 2 + 12 * len(entries) + 4
    places = {258: end, 273: end + 6}
    table = b"".join(
        struct.pack("<HHI", tag, kind, count)
        + (struct.pack("<I", places[tag]) if tag in places else struct.pack("<I", value))
        for tag, kind, count, value in entries
    )
    bits_each = struct.pack("<HHH", bits, bits, bits)
    path.write_bytes(struct.pack("<2sHIH", b"II", 42, 8, len(entries)) + table + b"\0" * 4 + bits_each + packed)


def reduced_then_full(path: Path, full: np.ndarray, **of_full: object) -> Path:
    """A TIFF whose first page is a thumbnail, as cameras write it, and the image itself in a page inside."""
    with tifffile.TiffWriter(path) as writer:
        writer.write(np.zeros((6, 8, 3), np.uint8), photometric="rgb", subifds=1, subfiletype=1)
        writer.write(full, **of_full)
    return path


def test_an_image_behind_its_thumbnail_is_read_at_full_size(tmp_path: Path) -> None:
    path = reduced_then_full(tmp_path / "a.tif", colours(np.uint16), photometric="rgb")
    assert np.array_equal(read(path), colours(np.uint16))


def test_an_image_before_its_reduced_copies_is_read(tmp_path: Path) -> None:
    path = tmp_path / "pyramid.tif"
    with tifffile.TiffWriter(path) as writer:
        writer.write(colours(), photometric="rgb")
        writer.write(colours()[::2, ::2], photometric="rgb", subfiletype=1)
    assert np.array_equal(read(path), colours())


@pytest.mark.parametrize("suffix", [".dng", ".tif", ".nef"])
def test_a_raw_mosaic_behind_its_thumbnail_is_read_as_bayer(tmp_path: Path, suffix: str) -> None:
    mosaic = np.random.default_rng(2).integers(64, 4096, SHAPE).astype(np.uint16)
    path = tmp_path / f"frame{suffix}"
    dng = [
        (50706, "B", 4, (1, 4, 0, 0), True),
        (50708, "s", 0, "Test", True),
        (271, "s", 0, "Test", True),
        (272, "s", 0, "Test", True),
    ]
    of_mosaic = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, (0, 1, 1, 2), True)]
    of_mosaic += [(50714, "H", 1, 64, True), (50717, "H", 1, 4095, True)]
    with tifffile.TiffWriter(path, byteorder="<") as writer:
        writer.write(np.zeros((6, 8, 3), np.uint8), photometric="rgb", subifds=1, subfiletype=1, extratags=dng)
        writer.write(mosaic, photometric="cfa", extratags=of_mosaic)
    assert (read_info(path).shape, read_info(path).is_raw) == (SHAPE, True)
    raw = read_image(path)
    assert isinstance(raw, RawFrame)
    assert np.array_equal(raw.mosaic, mosaic)
    assert (raw.bayer_order, raw.black_level_dn, raw.white_level_dn) == ("RGGB", 64.0, 4095.0)
    assert np.array_equal(read_frame(FrameSpec((path,), "linear")).rgb, demosaic(raw).rgb)
    with pytest.raises(FrameSetError, match='state encoding = "linear"'):
        read_frame(FrameSpec((path,), "srgb"))
    path.write_bytes(path.read_bytes()[:-3000])
    with pytest.raises(FrameSetError, match=f"frame{suffix}"):
        read_info(path)


def test_what_only_calls_itself_raw_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(FrameSetError, match=r"frame\.arw: is a camera raw file that cannot be read"):
        read_info(saved(tmp_path / "frame.arw", b"no camera wrote this" * 40))


def jpeg(**options: object) -> bytes:
    smooth = Image.fromarray(colours()).resize((240, 160), Image.Resampling.BICUBIC)
    return encoded(smooth, "JPEG", quality=90, **options)


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(jpeg()[:2] + b"\xff\xff" + jpeg()[2:], id="fill bytes"),
        pytest.param(jpeg()[:-2], id="no end marker"),
        pytest.param(jpeg(progressive=True)[:-2], id="progressive without an end marker"),
        pytest.param(jpeg() + b"a maker's trailer \xff\xd9 and more", id="trailer"),
        pytest.param(jpeg() + jpeg(), id="several pictures"),
        pytest.param(jpeg(restart_marker_rows=1), id="restart markers"),
    ],
)
def test_an_odd_but_valid_jpeg_is_read(tmp_path: Path, data: bytes) -> None:
    pixels = read(saved(tmp_path / "frame.jpg", data))
    plain = np.asarray(Image.open(BytesIO(jpeg())))
    assert np.abs(pixels.astype(float) - plain).mean() < 3.0


def test_a_jpeg_of_rgb_is_not_taken_for_luma_and_chroma(tmp_path: Path) -> None:
    data = jpeg(keep_rgb=True)
    assert np.array_equal(read(saved(tmp_path / "frame.jpg", data)), np.asarray(Image.open(BytesIO(data))))


@pytest.mark.parametrize("share", [0.5, 0.9])
@pytest.mark.parametrize("progressive", [False, True])
def test_half_a_jpeg_without_an_end_is_still_refused(tmp_path: Path, share: float, progressive: bool) -> None:
    data = jpeg(progressive=progressive)
    with pytest.raises(FrameSetError, match="truncated or damaged"):
        read_info(saved(tmp_path / "frame.jpg", data[: int(share * len(data))]))


def test_a_jpeg_of_12_bit_says_its_full_scale(tmp_path: Path) -> None:
    plane = np.linspace(0, 4095, SHAPE[0] * SHAPE[1]).reshape(SHAPE).astype(np.uint16)
    path = saved(tmp_path / "deep.jpg", imagecodecs.jpeg8_encode(plane, level=100, bitspersample=12))
    assert read_info(path).full_scale == 4095
    assert np.abs(read(path).astype(int) - plane).max() < 8


def test_a_jpeg_for_printers_is_refused_by_its_channels(tmp_path: Path) -> None:
    with pytest.raises(FrameSetError, match="has 4 channels of 8 bit"):
        read_info(saved(tmp_path / "c.jpg", encoded(Image.fromarray(colours()).convert("CMYK"), "JPEG")))


def test_three_grey_pages_are_the_lights_of_one_image(tmp_path: Path) -> None:
    planes = np.moveaxis(colours(np.uint16), -1, 0)
    for options in ({}, {"imagej": True, "metadata": {"axes": "CYX"}}, {"ome": True, "metadata": {"axes": "CYX"}}):
        path = tiff(tmp_path / "p.ome.tif", planes, photometric="minisblack", **options)
        assert np.array_equal(read(path), colours(np.uint16))
    with tifffile.TiffWriter(path) as writer:
        for name, plane in zip(("Blue", "Green", "Red"), planes[::-1], strict=True):
            writer.write(plane, photometric="minisblack", extratags=[(285, "s", 0, name, True)])
    assert np.array_equal(read(path), colours(np.uint16))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(FrameSetError, match="truncated or damaged"):
        read_info(path)


@pytest.mark.parametrize(
    ("axes", "words"),
    [("TYX", "holds 3 pages, frames of a sequence: save"), ("ZYX", "holds 3 pages, slices of a stack: save")],
)
def test_three_pages_of_one_light_are_no_image(tmp_path: Path, axes: str, words: str) -> None:
    planes = np.moveaxis(colours(np.uint16), -1, 0)
    for options in ({"imagej": True}, {"ome": True}):
        path = tiff(tmp_path / "p.ome.tif", planes, photometric="minisblack", metadata={"axes": axes}, **options)
        with pytest.raises(FrameSetError, match=words):
            read_info(path)


def test_pages_that_differ_are_no_image(tmp_path: Path) -> None:
    path = tmp_path / "p.tif"
    with tifffile.TiffWriter(path) as writer:
        for plane in (greys(), greys()[:-1], greys()):
            writer.write(plane, photometric="minisblack")
    with pytest.raises(FrameSetError, match="3 pages that are not grey ones of one size and kind"):
        read_info(path)
    for count in (2, 4):
        stack = np.stack([greys()] * count)
        with pytest.raises(FrameSetError, match=f"holds {count} pages: save the right one"):
            read_info(tiff(path, stack, photometric="minisblack"))


def exif_of(orientation: int) -> Image.Exif:
    exif = Image.Exif()
    exif[274] = orientation
    return exif


@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_image_is_read_as_it_is_seen(tmp_path: Path, orientation: int) -> None:
    stored = Image.fromarray(colours())
    png = saved(tmp_path / "a.png", encoded(stored, "PNG", exif=exif_of(orientation)))
    seen = np.asarray(ImageOps.exif_transpose(Image.open(png)))
    assert read_info(png).orientation == orientation
    assert np.array_equal(read(png), seen)
    options = {"photometric": "rgb", "extratags": [(274, "H", 1, orientation, True)]}
    assert np.array_equal(read(tiff(tmp_path / "a.tif", colours(), **options)), seen)
    for exif in (exif_of(orientation), exif_of(orientation).tobytes()):
        path = saved(tmp_path / "a.jpg", encoded(stored, "JPEG", quality=95, subsampling=0, exif=exif))
        jpeg_seen = np.asarray(ImageOps.exif_transpose(Image.open(path)))
        assert np.abs(read(path).astype(int) - jpeg_seen).max() <= 2


def test_an_orientation_that_is_none_or_cut_off_leaves_the_image_as_it_is() -> None:
    block = exif_of(6).tobytes().removeprefix(b"Exif\0\0")
    assert exif_orientation(block) == 6
    for end in range(len(block)):
        assert exif_orientation(block[:end]) in (1, 6)
    assert exif_orientation(exif_of(9).tobytes().removeprefix(b"Exif\0\0")) == 1
    assert exif_orientation(b"II*\0\xff\xff\xff\xff\xff\xff") == 1


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_mosaic_that_is_turned_keeps_its_colours(orientation: int) -> None:
    colour = np.tile(np.array([[0, 1], [1, 2]]), (4, 6))
    raw = RawFrame(colour.astype(np.uint16) * 1000 + 64, "RGGB", 0.0, 4095.0, CameraSettings(1.0, 1.0), 0)
    turned = upright(raw, orientation)
    named = np.tile(np.array(["RGB".index(name) for name in turned.bayer_order]).reshape(2, 2), (6, 6))
    rows, columns = turned.mosaic.shape
    assert (rows, columns) == shape_upright(colour.shape, orientation)
    assert np.array_equal(turned.mosaic, named[:rows, :columns] * 1000 + 64)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty: fetch the image itself"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n", "holds text"),
        (b"\n<!DOCTYPE html><html>not found</html>", "holds text"),
        (b"\x89PNG\r\r\n\x1a\r\n\0\0\0\rIHDR", "is truncated or damaged"),
        (b"\x89PNG\n\x1a\n\0\0\0\rIHDR", "is truncated or damaged"),
        (b"II*\0\x08\0\0\0\0\0\x08\0\0\0", "is truncated or damaged"),
        (b"BM\x36\x24\0\0\0\0\0\0\x36", "is not a PNG, TIFF, JPEG or camera raw image"),
        (b"\xff\xd8\xff", "is truncated or damaged"),
    ],
    ids=["nothing", "pointer", "page", "ends added", "ends taken", "pages in a ring", "bitmap", "start alone"],
)
def test_what_is_no_image_is_said_as_it_is(tmp_path: Path, data: bytes, words: str) -> None:
    path = tmp_path / "frame.png"
    path.write_bytes(data)
    with pytest.raises(FrameSetError, match=words):
        read_info(path)


def test_a_jpeg_ls_image_is_named_as_what_it_is(tmp_path: Path) -> None:
    path = tmp_path / "frame.jpg"
    path.write_bytes(imagecodecs.jpegls_encode(colours()))
    with pytest.raises(FrameSetError, match="JPEG-LS image, not a JPEG: save it as PNG"):
        read_image(path)


def test_an_animation_is_no_frame(tmp_path: Path) -> None:
    path = tmp_path / "frame.png"
    first, second = Image.fromarray(colours()), Image.fromarray(colours()[::-1].copy())
    first.save(path, save_all=True, append_images=[second])
    with pytest.raises(FrameSetError, match="an animation: save the right one"):
        read_image(path)


def test_an_image_without_pixels_is_not_called_too_large(tmp_path: Path) -> None:
    path = tmp_path / "frame.png"
    data = bytearray(encoded(Image.fromarray(colours()), "PNG"))
    data[16:20] = bytes(4)
    path.write_bytes(data)
    with pytest.raises(FrameSetError, match="claims 0x48 pixels: name another file"):
        read_info(path)
