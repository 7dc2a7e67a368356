"""Arrays of measured responses: what is written in each format arrives, and whatever else a file holds is refused."""

from __future__ import annotations

import contextlib
import io
import math
import pickle
import time
import warnings
import zipfile
import zlib

import h5py
import numpy as np
import pytest
import scipy.io
import xarray as xr
from foreign_files import damaged
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mvla_sim.channel.readers import array_files, array_values
from mvla_sim.channel.readers.array_files import ArrayFile, read_array_file
from mvla_sim.channel.readers.arrays import ArrayData, ArrayReader, read_responses
from mvla_sim.errors import ConfigError, DataError

pytestmark = pytest.mark.usefixtures("quick_children")

N_VIEW, N_AXIS = 4, 6
RNG = np.random.default_rng(5)
RESPONSE = RNG.normal(size=(N_VIEW, N_AXIS)) + 1j * RNG.normal(size=(N_VIEW, N_AXIS))
FREQUENCY = np.linspace(34.5e9, 37.5e9, N_AXIS)
ANGLES = np.arange(N_VIEW) * 90.0
POSITIONS = RNG.normal(size=(N_VIEW, 3))
ARRAYS = {"h": RESPONSE, "f": FREQUENCY, "phi": ANGLES, "at": POSITIONS, "count": np.arange(3, dtype=np.int16)}
COMPOUND = np.dtype([("real", "<f8"), ("imag", "<f8")])


def compound(values):
    """Complex numbers the way MATLAB puts them into HDF5."""
    pairs = np.zeros(values.shape, COMPOUND)
    pairs["real"], pairs["imag"] = values.real, values.imag
    return pairs


def write_mat(file, arrays=ARRAYS, **options):
    scipy.io.savemat(file, arrays, **options)


def write_mat73(file, arrays=ARRAYS):
    """What ``save -v7.3`` writes: HDF5 behind a block of 512 bytes, axes turned round, classes as attributes."""
    with h5py.File(file, "w", userblock_size=512) as handle:
        for name, values in arrays.items():
            turned = np.atleast_2d(values).T
            content = compound(turned) if turned.dtype.kind == "c" else turned
            dataset = handle.create_dataset(name.replace(".", "/"), data=content)
            dataset.attrs["MATLAB_class"] = np.bytes_("int16" if turned.dtype == np.int16 else "double")
    with file.open("r+b") as handle:
        handle.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")


def write_npz(file, arrays=ARRAYS):
    np.savez(file, **arrays)


def write_hdf5(file, arrays=ARRAYS, **options):
    with h5py.File(file, "w") as handle:
        for name, values in arrays.items():
            handle.create_dataset(name, data=values, **options)


def write_netcdf(file, arrays=ARRAYS, **options):
    variables = {
        name: ([f"{name}_{i}" for i in range(np.ndim(values))], np.asarray(values)) for name, values in arrays.items()
    }
    with warnings.catch_warnings(action="ignore"):  # complex numbers are no part of NetCDF-4
        xr.Dataset(variables).to_netcdf(file, engine="h5netcdf", invalid_netcdf=True, **options)


WRITERS = {
    "v5.mat": write_mat,
    "v7.mat": lambda file, arrays=ARRAYS: write_mat(file, arrays, do_compression=True),
    "v73.mat": write_mat73,
    "a.npz": write_npz,
    "a.h5": write_hdf5,
    "b.HDF5": lambda file, arrays=ARRAYS: write_hdf5(file, arrays, chunks=True, compression="gzip", shuffle=True),
    "a.nc": write_netcdf,
}  # fmt: skip


@pytest.fixture(params=WRITERS)
def written(request, tmp_path):
    """A file of each kind with the same arrays in it."""
    file = tmp_path / request.param
    WRITERS[request.param](file)
    return file


@pytest.fixture
def npz(tmp_path):
    """Write arrays in the format that is read fastest, and return the file."""

    def write(**changes):
        file = tmp_path / "a.npz"
        write_npz(file, ARRAYS | changes)
        return file

    return write


def one_line(file, call, *args, **options):
    """The one line with which a call on a file is refused."""
    with pytest.raises(DataError) as caught:
        call(file, *args, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert str(file) in message
    return message


def refused(file, **changes):
    return one_line(file, read_responses, ArrayReader(**({"data": "h", "axis": "f"} | changes)))


def read(file, **changes):
    return read_responses(file, ArrayReader(**({"data": "h", "axis": "f"} | changes)))


# ----------------------------------------------------------------------------------------------------- every format


@pytest.mark.usefixtures("real_children")
def test_what_is_written_is_read(written):
    data = read(written, angles="phi", positions="at", receivers="at")
    np.testing.assert_array_equal(data.values, RESPONSE)
    np.testing.assert_array_equal(data.axis, FREQUENCY)
    np.testing.assert_array_equal(data.angles_deg, ANGLES)
    np.testing.assert_array_equal(data.positions_m, POSITIONS)
    np.testing.assert_array_equal(data.receivers_m, POSITIONS)
    assert (data.values.dtype, data.axis.dtype, data.angles_deg.dtype) == (np.complex128, np.float64, np.float64)
    assert data.values.flags.c_contiguous


def test_a_file_lists_what_it_has(written):
    source = read_array_file(written)
    assert set(source.entries) == set(ARRAYS)
    assert source.entries["h"].shape == RESPONSE.shape
    np.testing.assert_array_equal(source.get("count"), ARRAYS["count"])
    assert source.get("count").dtype == np.int16
    with pytest.raises(DataError) as caught:
        source.get("S21")
    message = str(caught.value)
    assert message.startswith(f"{written}: has no variable 'S21'; it has ")
    assert "h (4, 6)" in message
    assert "count (" in message


TEXTS = {
    "a.mat": lambda file: write_mat(file, {"note": "by hand"}),
    "a.npz": lambda file: write_npz(file, {"note": np.array(["by hand"])}),
    "a.h5": lambda file: write_hdf5(file, {"note": "by hand"}),
    "a.nc": lambda file: xr.Dataset({"note": ("i", ["by hand"])}).to_netcdf(file, engine="h5netcdf"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_text_is_no_numbers(tmp_path, name):
    file = tmp_path / name
    TEXTS[name](file)
    message = one_line(file, lambda file: read_array_file(file).get("note"))
    assert "variable 'note' is " in message
    assert message.endswith("must be an array of numbers")


@pytest.mark.parametrize("name", ["a.mat", "a.npz", "a.h5", "a.nc"])
@pytest.mark.parametrize("content", [b"x", b"\x89HDF\r\n\x1a\n", b"PK\x03\x04" + bytes(60), bytes(4096)])
def test_other_content_is_refused(tmp_path, name, content):
    file = tmp_path / name
    file.write_bytes(content)
    refused(file)


def test_no_file_no_content_no_such_format(tmp_path):
    assert "no such file of arrays" in refused(tmp_path / "a.mat")
    (tmp_path / "b.mat").touch()
    assert "is empty" in refused(tmp_path / "b.mat")
    (tmp_path / "a.csv").write_text("1,2")
    assert "unknown suffix '.csv'; allowed: .mat, .npz, .h5, .hdf5, .nc" in refused(tmp_path / "a.csv")


def test_classic_netcdf_is_read(tmp_path):
    file = tmp_path / "a.nc"
    parts_of = {"re": (("view", "f"), RESPONSE.real), "im": (("view", "f"), RESPONSE.imag), "f": ("f", FREQUENCY)}
    xr.Dataset(parts_of).to_netcdf(file, engine="scipy")
    data = read(file, data="re", data_imag="im")
    np.testing.assert_array_equal(data.values, RESPONSE)
    np.testing.assert_array_equal(data.axis, FREQUENCY)
    square = {"re": (("f", "view"), RESPONSE.real[:, :4]), "im": (("f", "view"), RESPONSE.imag[:, :4])}
    xr.Dataset(square | {"f": FREQUENCY[:4]}).to_netcdf(file, engine="scipy")
    np.testing.assert_array_equal(read(file, data="re", data_imag="im").values, RESPONSE[:, :4].T)
    (tmp_path / "b.nc").write_bytes(b"CDF\x05" + bytes(100))
    assert "is no NetCDF file" in refused(tmp_path / "b.nc")


# --------------------------------------------------------------------------------------- what is special in a format


def test_structs_of_matlab(tmp_path):
    nested = {"f": FREQUENCY, "note": "text", "deep": {"x": 1.0}}
    many = np.array([(1.0,), (2.0,)], [("x", object)])
    write_mat(tmp_path / "a.mat", {"s": nested, "many": many, "cells": np.array([[1, "x"]], object), "on": np.True_})
    source = read_array_file(tmp_path / "a.mat")
    np.testing.assert_array_equal(source.get("s.f"), FREQUENCY)
    np.testing.assert_array_equal(source.get("s.deep.x"), 1)
    np.testing.assert_array_equal(source.get("many.x"), [1, 2])
    assert {name: entry.refusal for name, entry in source.entries.items()} == {
        "s.f": None, "s.note": "text", "s.deep.x": None, "many.x": None,
        "cells": "a cell array whose cells are text", "on": "of class logical",
    }  # fmt: skip
    write_mat73(tmp_path / "b.mat", {"s.f": FREQUENCY, "s.h": RESPONSE})
    data = read(tmp_path / "b.mat", data="s.h", axis="s.f")
    np.testing.assert_array_equal(data.values, RESPONSE)


def matlab_object(name, kind):
    """An object of MATLAB, as a string or a table, in a file of version 5: its names and no lengths."""
    texts = b"".join(
        np.array([1, len(text)], np.uint32).tobytes() + text.ljust(-(-len(text) // 8) * 8, b"\0")
        for text in (name.encode(), b"MCOS", kind.encode())
    )
    head = np.array([6, 8, 17, 0], np.uint32).tobytes() + texts
    return np.array([14, len(head)], np.uint32).tobytes() + head


def test_objects_of_matlab_beside_arrays(tmp_path):
    file = tmp_path / "a.mat"
    write_mat(file, {"f": FREQUENCY})
    start = file.read_bytes()
    write_mat(file, {"h": RESPONSE}, do_compression=True)
    objects = [matlab_object("note", "string"), matlab_object("when", "datetime")]
    packed = zlib.compress(objects[1])
    objects[1] = np.array([15, len(packed)], np.uint32).tobytes() + packed
    file.write_bytes(start + b"".join(objects) + file.read_bytes()[128:])
    data = read(file)
    np.testing.assert_array_equal(data.values, RESPONSE)
    np.testing.assert_array_equal(data.axis, FREQUENCY)
    for name, kind in (("note", "string"), ("when", "datetime")):
        message = f"variable '{name}' is of class {kind}, which only MATLAB can take apart; save its numbers as plain"
        assert message in refused(file, data=name)


def cells(parts):
    """A MATLAB cell array, a part a row."""
    array = np.empty((len(parts), 1), object)
    for i, part in enumerate(parts):
        array[i, 0] = part
    return array


def write_cells73(file, name, parts):
    """A cell array, or a field of an array of structs, in a file of MATLAB 7.3: references."""
    with h5py.File(file, "a") as handle:
        kind = np.bytes_("double")
        made = [handle.create_dataset(f"#refs#/{name}{i}", data=compound(p[None]) if p.dtype.kind == "c" else p[None])
                for i, p in enumerate(parts)]  # fmt: skip
        for dataset in made:
            dataset.attrs["MATLAB_class"] = kind
        table = handle.create_dataset(name.replace(".", "/"), (1, len(made)), h5py.ref_dtype)
        table[0] = [dataset.ref for dataset in made]
        if "." not in name:
            table.attrs["MATLAB_class"] = np.bytes_("cell")


@pytest.mark.parametrize("points", [N_AXIS, N_VIEW])
def test_a_cell_array_with_a_sweep_a_view(tmp_path, points):
    """Also of as many views as frequencies: the cells are the views."""
    rows, axis = [row[:points] for row in RESPONSE], FREQUENCY[:points]
    write_mat(
        tmp_path / "a.mat", {"h": cells([row[:, None] for row in rows]), "f": axis, "odd": cells(RESPONSE[0, :2])}
    )
    write_mat73(tmp_path / "b.mat", {"f": axis})
    write_cells73(tmp_path / "b.mat", "h", rows)
    write_cells73(tmp_path / "b.mat", "odd", [axis, axis[1:]])
    write_cells73(tmp_path / "b.mat", "s.h", rows)
    structs = np.zeros((1, N_VIEW), [("h", object)])
    for i, row in enumerate(rows):
        structs[0, i]["h"] = row
    write_mat(tmp_path / "c.mat", {"s": structs, "f": axis})
    for file, name in (("a.mat", "h"), ("b.mat", "h"), ("b.mat", "s.h"), ("c.mat", "s.h")):
        np.testing.assert_array_equal(read(tmp_path / file, data=name).values, RESPONSE[:, :points])
    assert "'odd' is a cell array whose cells have different lengths" in refused(tmp_path / "b.mat", data="odd")


def test_a_filter_that_is_not_there_is_named(tmp_path):
    file = tmp_path / "a.h5"
    write_hdf5(file, {"f": FREQUENCY})
    with h5py.File(file, "a") as handle:
        made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        made.set_chunk(RESPONSE.shape)
        made.set_filter(32001, h5py.h5z.FLAG_OPTIONAL, ())
        space = h5py.h5s.create_simple(RESPONSE.shape)
        h5py.h5d.create(handle.id, b"h", h5py.h5t.py_create(RESPONSE.dtype), space, made)
    message = (
        "'h' is packed by HDF5's filter 32001 (Blosc), which is not installed; pip install hdf5plugin, or write it"
    )
    assert message in refused(file)


def test_channels_have_names(tmp_path):
    words = ["HH", "HV", "VV"]
    files = {"a.npz": words, "a.mat": cells(words), "b.mat": np.array(words), "a.h5": words, "a.nc": words}
    for name, texts in files.items():
        WRITERS.get(name, write_mat)(tmp_path / name, {"h": FOUR, "f": FREQUENCY, "phi": ANGLES, "pol": texts})
        np.testing.assert_array_equal(read(tmp_path / name, angles="phi", channel="HV").values, 2 * RESPONSE)
        told = "of 3 (HH, HV, VV), such as polarisations; choose one with arrays.channel = 0 to 2, or by its name"
        assert told in refused(tmp_path / name, angles="phi")


def test_names_of_axes_tell_the_view(tmp_path):
    file = tmp_path / "a.nc"
    square = RESPONSE[:, :N_VIEW]
    for dims, wanted in ((("view", "f"), square), (("f", "view"), square.T)):
        data = {"h": (dims, square), "f": ("f", FREQUENCY[:N_VIEW]), "phi": ("view", ANGLES)}
        with warnings.catch_warnings(action="ignore"):
            xr.Dataset(data).to_netcdf(file, engine="h5netcdf", invalid_netcdf=True)
        np.testing.assert_array_equal(read(file).values, wanted)
        np.testing.assert_array_equal(read(file, angles="phi").values, wanted)


def test_what_is_no_number_in_hdf5_of_matlab(tmp_path):
    file = tmp_path / "a.mat"
    write_mat73(file)
    with h5py.File(file, "r+") as handle:
        handle["text"] = np.array([[97, 98]], np.uint16)
        handle["text"].attrs["MATLAB_class"] = np.bytes_("char")
        handle["nothing"] = np.zeros(2, np.uint64)
        handle["nothing"].attrs.update({"MATLAB_class": np.bytes_("double"), "MATLAB_empty": np.uint8(1)})
        handle["#refs#/a"] = 1.0
    source = read_array_file(file)
    assert source.entries["text"].refusal == "of class char"
    assert source.entries["nothing"].refusal == "empty"
    assert "#refs#/a" not in source.entries


def test_integers_and_single_precision_of_matlab(tmp_path):
    write_mat(tmp_path / "a.mat", {"h": RESPONSE.astype(np.complex64), "f": np.arange(N_AXIS, dtype=np.uint8)})
    data = read(tmp_path / "a.mat", axis_unit=1e9)
    np.testing.assert_array_equal(data.values, RESPONSE.astype(np.complex64))
    np.testing.assert_array_equal(data.axis, np.arange(N_AXIS) * 1e9)


def test_complex_integers_of_matlab(tmp_path):
    pairs = np.array([(1, -2), (3, 4)], [("real", "i2"), ("imag", "i2")])
    write_hdf5(tmp_path / "a.mat", {"h": pairs})
    np.testing.assert_array_equal(read_array_file(tmp_path / "a.mat").get("h"), [1 - 2j, 3 + 4j])


def test_groups_of_hdf5(tmp_path):
    write_hdf5(tmp_path / "a.h5", {"run/h": compound(RESPONSE.astype(">c16")), "run/axes/f": FREQUENCY.astype(">f8")})
    data = read(tmp_path / "a.h5", data="run/h", axis="/run/axes/f")
    np.testing.assert_array_equal(data.values, RESPONSE)
    np.testing.assert_array_equal(data.axis, FREQUENCY)
    assert data.axis.dtype.isnative


def test_netcdf_unpacks_and_leaves_bare_dimensions_out(tmp_path):
    packed = {"level": {"dtype": "int16", "scale_factor": 0.5, "add_offset": 10.0, "_FillValue": -1}}
    write_netcdf(tmp_path / "a.nc", {"level": np.array([10.0, 11.5, math.nan])}, encoding=packed)
    source = read_array_file(tmp_path / "a.nc")
    assert tuple(source.entries) == ("level",)
    np.testing.assert_array_equal(source.get("level"), [10.0, 11.5, math.nan])


def test_links_out_of_a_file_are_not_followed(tmp_path):
    write_hdf5(tmp_path / "secret.h5", {"x": FREQUENCY})
    (tmp_path / "raw").write_bytes(FREQUENCY.tobytes())
    file = tmp_path / "a.h5"
    layout = h5py.VirtualLayout((N_AXIS,), "f8")
    layout[:] = h5py.VirtualSource(tmp_path / "secret.h5", "x", (N_AXIS,))
    with h5py.File(file, "w") as handle:
        handle["f"] = FREQUENCY
        handle["outside"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/x")
        handle["soft"] = h5py.SoftLink("/f")
        handle["nowhere"] = h5py.SoftLink("/nothing")
        handle["loop/again"] = handle["/"]
        handle["loop/f"] = handle["f"]
        handle.create_virtual_dataset("virtual", layout)
        handle.create_dataset("raw", (N_AXIS,), "f8", external=[(str(tmp_path / "raw"), 0, FREQUENCY.nbytes)])
    source = read_array_file(file)
    assert {name: entry.refusal for name, entry in source.entries.items()} == {
        "f": None, "loop/f": None, "virtual": "in another file", "raw": "in another file",
    }  # fmt: skip
    for name in ("outside", "soft"):
        with pytest.raises(DataError, match="has no variable"):
            source.get(name)


def test_pickles_are_never_loaded(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("a pickle was loaded",))

    file = tmp_path / "a.npz"
    np.savez(file, h=np.array([Bomb()], object), f=FREQUENCY)
    assert "variable 'h' is text or objects, must be an array of numbers" in refused(file)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("h.npy", pickle.dumps(Bomb()))
    refused(file)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_packing_without_a_bound_is_refused(tmp_path, method):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", method) as archive:
        archive.writestr("h.npy", bytes(1000))
    assert f"is packed by method {method}, which NumPy does not write" in refused(tmp_path / "a.npz")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_arrays_of_one_name_are_refused(tmp_path):
    content = io.BytesIO()
    np.save(content, FREQUENCY)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("f.npy", content.getvalue())
        archive.writestr("f.npy", content.getvalue())
    assert "has two arrays of the name 'f'" in refused(tmp_path / "a.npz")
    write_mat(tmp_path / "a.mat", {"f": FREQUENCY})
    content = (tmp_path / "a.mat").read_bytes()
    (tmp_path / "a.mat").write_bytes(content + content[128:])
    assert "has two variables of one name" in refused(tmp_path / "a.mat")


@pytest.mark.parametrize("kind", ["a.npz", "a.h5", "a.mat"])
def test_only_so_many_arrays_are_listed(tmp_path, kind):
    file = tmp_path / kind
    WRITERS.get(kind, write_mat)(file, {f"x{i:02d}": np.zeros(1) for i in range(30)})
    assert "has no variable 'f'; it has x00 (1" in (message := refused(file))
    assert message.endswith("and 10 more")


def test_too_many_arrays_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(array_values, "_MOST_ARRAYS", 3)
    write_npz(tmp_path / "a.npz")
    assert "has more than 3 arrays" in refused(tmp_path / "a.npz")


# ------------------------------------------------------------------------------------------ sizes that are not there


def npy_header(shape, descr="<f8"):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue()


@pytest.mark.parametrize("shape", [(10**15,), (2**31, 2**31), (7,), (-1,), (2**62, 4)])
def test_a_lying_header_inside_npz(tmp_path, shape):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("f.npy", npy_header(shape) + FREQUENCY.tobytes())
    assert "variable 'f' announces shape" in refused(tmp_path / "a.npz")


def test_a_deflated_bomb_inside_npz_costs_no_memory(tmp_path, monkeypatch):
    """Ten megabytes that say they are forty gigabytes, with a header to match."""
    file = tmp_path / "a.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("f.npy", "w") as stream:
        stream.write(npy_header((10**7,)))
        for _ in range(80):
            stream.write(bytes(10**6))
    monkeypatch.setattr("psutil.virtual_memory", lambda: type("Memory", (), {"available": 100 * 2**20}))
    assert "the numbers of 'f' need 0.4 GiB, 0.1 GiB are free" in refused(file)


@pytest.mark.usefixtures("real_children")
@pytest.mark.parametrize("name", ["a.h5", "a.mat", "a.nc"])
def test_a_huge_empty_dataset_is_refused_at_once(tmp_path, name):
    file = tmp_path / name
    with h5py.File(file, "w") as handle:
        handle.create_dataset("f", (10**6, 10**6), "f8", chunks=(100, 100))
    start = time.perf_counter()
    assert "variable 'f' announces shape (1000000, 1000000)" in refused(file)
    assert time.perf_counter() - start < 10  # seconds, most of them for a process of its own on a busy machine


def test_a_lying_header_in_a_matlab_file(tmp_path):
    file = tmp_path / "a.mat"
    write_mat(file, {"f": np.zeros((3, 5))})
    content = file.read_bytes()
    lengths = np.array([3, 5], np.int32).tobytes()
    assert content.count(lengths) == 1
    file.write_bytes(content.replace(lengths, np.array([2**30, 2**30], np.int32).tobytes()))
    assert "variable 'f' announces shape (1073741824, 1073741824)" in refused(file)


@pytest.mark.usefixtures("real_children")
def test_a_bomb_in_a_matlab_file_is_stopped(tmp_path, monkeypatch):
    """A struct tells its size only while it is read, so the other process has a bound."""
    inner = io.BytesIO()
    scipy.io.savemat(inner, {"s": {"x": np.zeros(40_000_000)}})
    packed = zlib.compress(inner.getvalue()[128:], 1)
    file = tmp_path / "a.mat"
    header = inner.getvalue()[:128]
    del inner
    file.write_bytes(header + np.array([15, len(packed)], np.uint32).tobytes() + packed)
    low = "import psutil; psutil.virtual_memory = lambda: type('Memory', (), {'available': 2**28}); "
    monkeypatch.setattr(array_files, "_CHILD", low + array_files._CHILD)
    assert "MemoryError" in refused(file) or "Unable to allocate" in refused(file)


# --------------------------------------------------------------------------------------- what kills the other process


@pytest.mark.usefixtures("real_children")
def test_a_byte_that_crashes_the_library(tmp_path):
    """SciPy takes the code of a data type for the place in a table, unchecked."""
    file = tmp_path / "a.mat"
    write_mat(file, {"f": np.arange(8.0).reshape(2, 4)})
    content = bytearray(file.read_bytes())
    assert content[176] == 9  # double
    content[177] = 255
    file.write_bytes(content)
    refused(file)


@pytest.mark.usefixtures("real_children")
def test_a_crash_is_an_error_of_the_file(tmp_path, monkeypatch):
    write_mat(tmp_path / "a.mat")
    monkeypatch.setattr(array_files, "_CHILD", "import os; os.kill(os.getpid(), 11)")
    assert "a.mat: is damaged or not a .mat file (reading it ends with signal 11)" in refused(tmp_path / "a.mat")


@pytest.mark.usefixtures("real_children")
def test_a_hang_is_an_error_of_the_file(tmp_path, monkeypatch):
    write_mat(tmp_path / "a.mat")
    monkeypatch.setattr(array_files, "_PATIENCE_S", 0.0)
    monkeypatch.setattr(array_files, "_CHILD", "import time; time.sleep(60)")
    start = time.perf_counter()
    assert "a.mat: is not read within 4 s" in refused(tmp_path / "a.mat")
    assert time.perf_counter() - start < 10


@pytest.mark.usefixtures("real_children")
def test_the_other_process_reads_nothing_beside_the_caller(tmp_path, monkeypatch):
    """A module in the working folder is not taken for one of the libraries."""
    write_hdf5(tmp_path / "a.h5")
    (tmp_path / "json.py").write_text("raise SystemExit(3)")
    (tmp_path / "h5py.py").write_text("raise SystemExit(3)")
    monkeypatch.chdir(tmp_path)
    np.testing.assert_array_equal(read_array_file("a.h5").get("f"), FREQUENCY)


# -------------------------------------------------------------------------------------------- shapes and orientation


def test_a_response_is_turned_to_the_lengths_of_the_others(npz):
    np.testing.assert_array_equal(read(npz(h=RESPONSE.T)).values, RESPONSE)
    np.testing.assert_array_equal(read(npz(h=RESPONSE.T), angles="phi").values, RESPONSE)
    np.testing.assert_array_equal(read(npz(h=RESPONSE[None, :, :, None])).values, RESPONSE)


@pytest.mark.parametrize("angles", [None, "phi"])
def test_the_views_of_a_square_response_must_be_told(npz, angles):
    square = RESPONSE[:, :N_VIEW]
    file = npz(h=square, f=FREQUENCY[:N_VIEW])
    told = "has shape (4, 4), whose lengths do not tell which axis is the view; set arrays.view_axis = 0 (a row a view)"
    assert told + " or 1 (a column a view)" in refused(file, angles=angles)
    np.testing.assert_array_equal(read(file, angles=angles, view_axis=0).values, square)
    np.testing.assert_array_equal(read(file, angles=angles, view_axis=1).values, square.T)
    assert "arrays.view_axis = 1 does not fit" in refused(npz(), view_axis=1)


FOUR = RESPONSE[..., None] * np.array([1, 2, 3])  # [view, axis, channel]


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 0, 1), (2, 1, 0), (0, 2, 1), (1, 2, 0)])
def test_one_of_several_channels_is_chosen(npz, order):
    file = npz(h=FOUR.transpose(order))
    np.testing.assert_array_equal(read(file, angles="phi", channel=2).values, 3 * RESPONSE)
    np.testing.assert_array_equal(read(file, channel=0, view_axis=order.index(0)).values, RESPONSE)
    message = refused(file, angles="phi")
    assert "has one more axis, of 3, such as polarisations; choose one with arrays.channel = 0 to 2" in message
    with pytest.raises(ConfigError, match=r"arrays\.channel = 3: allowed: 0 to 2 of .*'h'"):
        read(file, angles="phi", channel=3)
    with pytest.raises(ConfigError, match=r"arrays\.channel = 'HH': .*give one of its names, if the file lists them"):
        read(file, angles="phi", channel="HH")


def test_a_channel_of_a_table_is_none(npz):
    with pytest.raises(ConfigError, match=r"arrays\.channel = 0: .*'h' has no third axis, only shape \(4, 6\)"):
        read(npz(), channel=0)


def test_one_view_of_several_channels(npz):
    file = npz(h=FOUR[0], phi=7.0)
    np.testing.assert_array_equal(read(file, angles="phi", channel=1).values, 2 * RESPONSE[:1])


def parts(values):
    return np.stack([values.real, values.imag], axis=-1)


def test_real_and_imaginary_parts_in_a_last_axis_of_two(npz, caplog):
    np.testing.assert_array_equal(read(npz(h=parts(RESPONSE))).values, RESPONSE)
    np.testing.assert_array_equal(read(npz(h=parts(RESPONSE.T)), angles="phi").values, RESPONSE)
    np.testing.assert_array_equal(
        read(
            npz(h=parts(RESPONSE[0])),
        ).values,
        RESPONSE[:1],
    )
    np.testing.assert_array_equal(read(npz(h=parts(FOUR)), angles="phi", channel=1).values, 2 * RESPONSE)
    assert {"last axis of two is taken for real and imaginary parts" in r.message for r in caplog.records} == {True}
    taps = parts(RESPONSE)
    file = npz(h=taps, f=np.arange(N_AXIS) * 0.25e-9)
    np.testing.assert_array_equal(read(file, axis_kind="delay", channel=1, angles="phi").values, taps[..., 1])


@pytest.mark.parametrize("unit", [np.rad2deg, lambda angle: angle])
def test_amplitude_and_phase_are_no_parts(npz, unit):
    turning = np.exp(1j * np.linspace(0, 12, RESPONSE.size)).reshape(RESPONSE.shape)
    amplitude, phase = np.abs(RESPONSE), unit(np.angle(turning))
    for first in (amplitude, -40 + amplitude):
        file = npz(h=np.stack([first, phase], -1), re=first, im=phase)
        assert "they look like amplitude and phase; save real and imaginary parts" in refused(file)
        assert "they look like amplitude and phase" in refused(file, data="re", data_imag="im")


@pytest.mark.parametrize("shape", [(N_AXIS,), (1, N_AXIS), (N_AXIS, 1)])
def test_one_view_may_have_one_axis(npz, shape):
    file = npz(h=RESPONSE[0].reshape(shape), phi=7.0, at=POSITIONS[0])
    data = read(file, angles="phi", positions="at")
    np.testing.assert_array_equal(data.values, RESPONSE[:1])
    np.testing.assert_array_equal(data.angles_deg, [7.0])
    np.testing.assert_array_equal(data.positions_m, POSITIONS[:1])


def test_a_falling_axis_is_turned_round_with_its_response(npz):
    data = read(npz(h=RESPONSE[:, ::-1], f=FREQUENCY[::-1]))
    np.testing.assert_array_equal(data.values, RESPONSE)
    np.testing.assert_array_equal(data.axis, FREQUENCY)


def test_units_of_the_axis(npz):
    delay_ns = np.arange(N_AXIS) * 0.25 + 3
    data = read(npz(f=delay_ns), axis_kind="delay", axis_unit=1e-9)
    np.testing.assert_allclose(data.axis, delay_ns * 1e-9, rtol=1e-15)  # one rounding of float64


def test_the_imaginary_part_may_be_apart(npz):
    file = npz(re=RESPONSE.real.astype(np.float32), im=RESPONSE.imag.astype(np.float32))
    data = read(file, data="re", data_imag="im")
    np.testing.assert_array_equal(data.values, RESPONSE.astype(np.complex64))


def test_a_delay_response_may_be_real(npz):
    data = read(npz(h=np.abs(RESPONSE), f=np.arange(N_AXIS) * 0.25e-9), axis_kind="delay")
    np.testing.assert_array_equal(data.values, np.abs(RESPONSE))


def test_positions_in_a_plane_and_the_other_way_round(npz):
    flat = np.column_stack([POSITIONS[:, :2], np.zeros(N_VIEW)])
    np.testing.assert_array_equal(read(npz(at=POSITIONS[:, :2]), positions="at").positions_m, flat)
    np.testing.assert_array_equal(read(npz(at=POSITIONS[:, :2].T), positions="at").positions_m, flat)
    np.testing.assert_array_equal(read(npz(at=POSITIONS.T), positions="at").positions_m, POSITIONS)


def test_nothing_is_made_up(npz):
    data = read(npz())
    assert (data.angles_deg, data.positions_m, data.receivers_m) == (None, None, None)


def bad(values, index, value):
    values = values.copy()
    values[index] = value
    return values


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({"h": RESPONSE[:, :5]}, {}, "variable 'h' has shape (4, 5), must be (views, 6): views, values"),
        ({"h": RESPONSE[:3]}, {"angles": "phi"}, "variable 'h' has shape (3, 6), must be (4, 6)"),
        ({"h": RESPONSE[0]}, {"angles": "phi"}, "variable 'h' has shape (6,)"),
        ({"h": RESPONSE[:, :, None] * np.ones(2)}, {}, "variable 'h' has shape (4, 6, 2)"),
        ({"h": np.zeros((0, 6), complex)}, {}, "variable 'h' has shape (0, 6)"),
        ({"h": RESPONSE.real}, {}, "variable 'h' is real; a frequency response is complex"),
        ({"h": bad(RESPONSE, (2, 3), np.nan)}, {}, "variable 'h' is (nan+0j) at view 2, point 3 (from 0)"),
        ({"h": bad(RESPONSE, (1, 0), np.inf).T}, {}, "at view 1, point 0 (from 0), must be finite"),
        ({"h": RESPONSE > 0}, {}, "variable 'h' is of type bool, must be an array of numbers"),
        ({"h": RESPONSE.astype("U")}, {}, "variable 'h' is text, must be an array of numbers"),
        ({"h": RESPONSE.astype(np.clongdouble)}, {}, "variable 'h' is of type complex256"),
        ({}, {"data": "S21"}, "has no variable 'S21'; it has h (4, 6), f (6,), phi (4,), at (4, 3), count (3,)"),
        ({}, {"data": "S\n21"}, "has no variable 'S 21'"),
        ({}, {"axis": "g"}, "has no variable 'g'"),
        ({}, {"angles": "g"}, "has no variable 'g'"),
        ({}, {"data_imag": "g"}, "has no variable 'g'"),
        ({}, {"data_imag": "h"}, "'h' is complex; as parts of one response both must be real"),
        ({"h": RESPONSE.real, "i": RESPONSE.real.T}, {"data_imag": "i"}, "has shape (4, 6), 'i' has (6, 4)"),
        ({"f": FREQUENCY + 0j}, {}, "variable 'f' is complex, must be real"),
        ({"f": bad(FREQUENCY, 2, np.nan)}, {}, "variable 'f' is nan at place 2 (from 0), must be finite"),
        ({"f": FREQUENCY}, {"axis_unit": 1e300}, "variable 'f' is inf at place 0 (from 0), must be finite"),
        ({"f": bad(FREQUENCY, 3, FREQUENCY[2])}, {}, "strictly: at place 3 (from 0) 35700000000 follows 3570000"),
        ({"f": FREQUENCY * 0}, {}, "must rise or fall strictly: at place 1"),
        ({"f": bad(FREQUENCY, 5, 38e9)}, {}, "is not in even steps: from place 4 to 5 it is 1.1e+09, mostly 600000000"),
        ({"f": np.array([-1.7e308, 1.6e308])}, {}, "is not in even steps"),
        ({"f": np.array(36e9)}, {}, "axis 'f' has shape (), must be a list of at least 2 values"),
        ({"f": np.ones((2, 3))}, {}, "axis 'f' has shape (2, 3), must be a list of at least 2 values"),
        ({"phi": ANGLES[:3]}, {"angles": "phi", "positions": "at"}, "has 3 angles, 4 positions; each view needs one"),
        ({"phi": bad(ANGLES, 1, np.inf)}, {"angles": "phi"}, "variable 'phi' is inf at place 1"),
        ({"phi": POSITIONS}, {"angles": "phi"}, "variable 'phi' has shape (4, 3), must be [n_view] degrees"),
        ({"at": np.ones((4, 4))}, {"positions": "at"}, "has shape (4, 4), must be [n_view, 3] or [n_view, 2]"),
        ({"at": np.ones(4)}, {"positions": "at"}, "variable 'at' has shape (4,), must be [n_view, 3]"),
        ({"at": bad(POSITIONS, (1, 2), np.nan)}, {"receivers": "at"}, "variable 'at' is nan at place 1, place 2"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named(npz, changes, options, message):
    assert message in refused(npz(**changes), **options)


def test_the_bound_on_uneven_steps(npz):
    step = FREQUENCY[1] - FREQUENCY[0]
    read(npz(f=bad(FREQUENCY, 3, FREQUENCY[3] + 0.9e-2 * step + 0.123)))
    assert "from place 2 to 3" in refused(npz(f=bad(FREQUENCY, 3, FREQUENCY[3] + 1.1e-2 * step + 0.123)))


FINE = np.linspace(34.5e9, 37.5e9, 3001)  # 1 MHz apart


@pytest.mark.parametrize(
    "axis",
    [
        np.linspace(34.5e9, 37.5e9, 60_001).astype(np.float32),  # 50 kHz; single precision holds 4 kHz
        np.linspace(34.5e9, 37.5e9, 60_001).astype(np.float32).astype(float),
        np.round(np.linspace(34.5e9, 37.5e9, 2999), -5),  # printed with six digits
        np.round(np.linspace(34.5e9, 37.5e9, 70_001), -3),
    ],
)
def test_rounded_axes_are_even(npz, axis):
    data = read(npz(h=np.ones((1, axis.size), complex), f=axis))
    np.testing.assert_allclose(data.axis, axis, rtol=2e-6)  # half of the last digit
    data = read(npz(h=np.ones((1, axis.size), complex), f=axis / 1e9), axis_unit=1e9)
    np.testing.assert_allclose(data.axis, axis, rtol=2e-6)


@pytest.mark.parametrize(
    "axis", [np.delete(FINE, 7), np.round(np.geomspace(34.5e9, 37.5e9, 101), -5), bad(FINE, 8, FINE[8] + 1e5 + 1)]
)
def test_uneven_axes_are_not_taken_for_rounded_ones(npz, axis):
    assert "is not in even steps" in refused(npz(h=np.ones((1, axis.size), complex), f=axis))


def test_wrong_arguments(npz):
    for changes in ({"axis_kind": "range"}, {"axis_unit": 0.0}, {"axis_unit": math.inf}, {"axis_unit": -1.0}):
        with pytest.raises(ConfigError, match=next(iter(changes))):
            read(npz(), **changes)


# ------------------------------------------------------------------------------------------------------------ fuzzing

SMALL = {"h": RESPONSE[:2, :3], "f": FREQUENCY[:3], "count": np.arange(2)}
CHANGES = st.lists(st.tuples(st.integers(0, 1 << 16), st.integers(0, 255)), max_size=4)
CUTS = st.one_of(st.just(0), st.integers(0, 1 << 16))


@pytest.fixture(scope="module")
def goods(tmp_path_factory):
    """Bytes of a small file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    for name, write in WRITERS.items():
        write(folder / name, SMALL)
    return {name: (folder / name).read_bytes() for name in WRITERS}


def survives(file, content):
    """Read what may be anything: arrays, or one line on what is wrong, and nothing else."""
    file.write_bytes(content)
    with contextlib.suppress(DataError):
        assert isinstance(read_array_file(file), ArrayFile)
    with contextlib.suppress(DataError):
        assert isinstance(read(file), ArrayData)


@settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=CUTS, changes=CHANGES)
def test_a_damaged_npz_never_crashes(tmp_path_factory, goods, cut, changes):
    survives(tmp_path_factory.getbasetemp() / "damaged.npz", damaged(goods["a.npz"], cut, changes))


@settings(max_examples=200, deadline=None)
@given(st.binary(min_size=1, max_size=200), st.sampled_from([b"", b"PK\x03\x04", b"\x93NUMPY\x01\x00"]))
def test_any_bytes_as_npz_never_crash(tmp_path_factory, content, start):
    survives(tmp_path_factory.getbasetemp() / "anything.npz", start + content)


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=100))
def test_any_header_of_an_array_in_npz_never_crashes(tmp_path_factory, text):
    header = text.encode("latin1", "replace")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("f.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(16))
    survives(tmp_path_factory.getbasetemp() / "header.npz", stream.getvalue())


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "a.npz"])
@settings(max_examples=5, deadline=None)  # a process for each; what the libraries do with damage is theirs
@given(cut=CUTS, changes=CHANGES)
def test_a_damaged_file_never_crashes(tmp_path_factory, goods, name, cut, changes):
    survives(tmp_path_factory.getbasetemp() / f"damaged-{name}", damaged(goods[name], cut, changes))


@pytest.mark.parametrize(("suffix", "start"), [(".mat", b" " * 124 + b"\x00\x01IM"), (".h5", b"\x89HDF\r\n\x1a\n")])
@settings(max_examples=5, deadline=None)
@given(content=st.binary(min_size=1, max_size=300))
def test_any_bytes_never_crash(tmp_path_factory, suffix, start, content):
    survives(tmp_path_factory.getbasetemp() / f"anything{suffix}", start + content)
