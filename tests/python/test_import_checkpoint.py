"""The importer of released checkpoints: what it reads, and what it refuses to."""

import io
import json
import pathlib
import pickle
import struct
import subprocess
import sys
import tempfile
import unittest
import zipfile

import numpy as np

TOOLS = pathlib.Path(__file__).resolve().parents[2] / "python" / "tools"
sys.path.insert(0, str(TOOLS))
import import_checkpoint as importer  # noqa: E402
from import_checkpoint import checksums  # noqa: E402


class Global:
    """Pickles as the name `module.name`."""

    def __init__(self, module, name):
        self.module, self.name = module, name


class Reduced:
    """Pickles as a call."""

    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments


class Filled:
    """Pickles as an object that gets items, then attributes."""

    def __init__(self, start, items, attributes):
        self.start, self.items, self.attributes = start, items, attributes


class Stored:
    """Pickles as a persistent reference."""

    def __init__(self, *pid):
        self.pid = pid


class Pickler(pickle._Pickler):  # the Python one, to write names of modules that are not installed
    def save(self, value, *rest, **options):
        if isinstance(value, Global):
            self.write(b"c" + f"{value.module}\n{value.name}\n".encode())
        elif isinstance(value, Reduced):
            self.save(value.function)
            self.save(value.arguments)
            self.write(pickle.REDUCE)
        elif isinstance(value, Filled):
            self.save(value.start)
            self.write(pickle.MARK)
            for key, item in value.items.items():
                self.save(key)
                self.save(item)
            self.write(pickle.SETITEMS)
            self.save(value.attributes)
            self.write(pickle.BUILD)
        elif isinstance(value, Stored):
            self.save(value.pid)
            self.write(pickle.BINPERSID)
        else:
            super().save(value, *rest, **options)

    def memoize(self, _):
        pass


def dumped(value):
    out = io.BytesIO()
    Pickler(out, 2).dump(value)
    return out.getvalue()


FLOAT = Global("torch", "FloatStorage")


def tensor(key, shape, strides=None, offset=0, count=None, kind=FLOAT):
    size = int(np.prod(shape, dtype=object))
    if strides is None:
        strides = tuple(int(np.prod(shape[i + 1 :], dtype=object)) for i in range(len(shape)))
    storage = Stored("storage", kind, key, "cpu", size if count is None else count)
    hooks = Reduced(Global("collections", "OrderedDict"))
    return Reduced(Global("torch._utils", "_rebuild_tensor_v2"), storage, offset, shape, strides, False, hooks)


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def checkpoint(self, content, storages=(), name="a.ckpt", compression=zipfile.ZIP_STORED, raw=None):
        path = self.folder / name
        with zipfile.ZipFile(path, "w", compression) as archive:
            archive.writestr("a/data.pkl", dumped(content) if raw is None else raw)
            for key, values in dict(storages).items():
                archive.writestr(f"a/data/{key}", values)
        return path

    def refused(self, path, pattern):
        with self.assertRaisesRegex(importer.CheckpointError, pattern):
            importer.read_checkpoint(path)


class Reading(Case):
    def test_values_strides_and_kinds(self):
        values = np.arange(12, dtype="<f4")
        content = {
            "module.a": tensor("0", (3, 4)),
            "module.b": tensor("0", (4, 3), (1, 4), 0, 12),
            "module.c": tensor("0", (2,), (5,), 3, 12),
            "d": tensor("1", (2,), kind=Global("torch", "HalfStorage")),
            "module.e": tensor("2", (), kind=Global("torch", "DoubleStorage")),
        }
        storages = {"0": values.tobytes(), "1": np.array([0.5, -2], "<f2").tobytes(), "2": np.array(0.25, "<f8").tobytes()}
        got = importer.read_checkpoint(self.checkpoint(content, storages))
        np.testing.assert_array_equal(got["a"], values.reshape(3, 4))
        np.testing.assert_array_equal(got["b"], values.reshape(3, 4).T)
        np.testing.assert_array_equal(got["c"], [3, 8])
        np.testing.assert_array_equal(got["d"], [0.5, -2])
        self.assertEqual(got["e"], 0.25)
        self.assertEqual({value.dtype for value in got.values()}, {np.dtype("<f4")})

    def test_a_state_dictionary_with_its_attributes(self):
        start = Reduced(Global("collections", "OrderedDict"))
        content = Filled(start, {"module.w": tensor("0", (1,))}, {"_metadata": Reduced(Global("collections", "OrderedDict"))})
        path = self.checkpoint(content, {"0": np.array([7], "<f4").tobytes()})
        self.assertEqual(importer.read_checkpoint(path)["w"], 7)


class Hostile(Case):
    def test_no_name_but_those_of_tensors(self):
        marker = self.folder / "executed"
        for call in [
            Reduced(Global("os", "system"), f"touch {marker}"),
            Reduced(Global("builtins", "eval"), f"open({str(marker)!r}, 'w')"),
            Reduced(Global("subprocess", "check_call"), ["touch", str(marker)]),
            Reduced(Global("torch", "load"), "x"),
            Reduced(Global("torch", "os.system"), "x"),
            Reduced(Global("collections", "namedtuple"), "x", "y"),
            Reduced(Global("importlib", "import_module"), "os"),
        ]:
            self.refused(self.checkpoint({"w": call}), "no use for")
        by_stack = b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x01x\x85R."
        self.refused(self.checkpoint(None, raw=by_stack), "no use for")
        self.assertFalse(marker.exists())

    def test_calls_of_what_is_allowed_with_nonsense(self):
        rebuild = Global("torch._utils", "_rebuild_tensor_v2")
        for call in [
            Reduced(rebuild, "os", 0, (1,), (1,)),
            Reduced(rebuild),
            Reduced(FLOAT, 1 << 60),
            Reduced(Global("torch._utils", "_rebuild_parameter"), "x"),
            Reduced(rebuild, Stored("storage", FLOAT, "0", "cpu", 1), 0, (1, 2), (1,)),
            Reduced(rebuild, Stored("storage", FLOAT, "0", "cpu", 1), 0, (-1,), (1,)),
            Reduced(rebuild, Stored("storage", FLOAT, "0", "cpu", 1), 0, (True,), (1,)),
            Reduced(rebuild, Stored("storage", FLOAT, "0", "cpu", 1), -1, (1,), (1,)),
            Reduced(rebuild, Stored("storage", "x", "0", "cpu", 1), 0, (1,), (1,)),
            Reduced(rebuild, Stored("module", FLOAT, "0", "cpu", 1), 0, (1,), (1,)),
        ]:
            self.refused(self.checkpoint({"w": call}, {"0": b"\0" * 4}), "")

    def test_shapes_beyond_the_storage(self):
        four = {"0": b"\0" * 16}
        self.refused(self.checkpoint({"w": tensor("0", (1 << 20, 1 << 20), (0, 0), 0, 4)}, four), "does not fit")
        self.refused(self.checkpoint({"w": tensor("0", (2,), (1,), 3, 4)}, four), "does not fit")
        self.refused(self.checkpoint({"w": tensor("0", (2,), (4,), 0, 4)}, four), "does not fit")
        self.refused(self.checkpoint({"w": tensor("0", (0,), (1,), 0, 4)}, four), "does not fit")
        self.refused(self.checkpoint({"w": tensor("0", (4,), (1,), 0, 5)}, four), "stored values")
        self.refused(self.checkpoint({"w": tensor("1", (4,))}, four), "is missing")
        self.refused(self.checkpoint({"w": tensor("../../x", (4,))}, four), "is missing")

    def test_broken_files(self):
        good = self.checkpoint({"w": tensor("0", (4,))}, {"0": b"\0" * 16})
        content = good.read_bytes()
        for length in range(0, len(content), 7):
            path = self.folder / "cut.ckpt"
            path.write_bytes(content[:length])
            self.refused(path, "")
        self.refused(self.checkpoint({"w": tensor("0", (4,))}, {"0": b"\0" * 16}, compression=zipfile.ZIP_DEFLATED), "stored")
        self.refused(self.checkpoint({"w": tensor("0", (1,))}, {"0": np.array([np.nan], "<f4").tobytes()}), "finite")
        self.refused(self.checkpoint([1, 2]), "dictionary")
        self.refused(self.checkpoint({"w": 3}), "no tensor")
        self.refused(self.checkpoint({3: tensor("0", (1,))}), "no tensor")
        for raw in [b"", b".", b"\x80\x02", b"\xff" * 100, b"(" * 10000, b"\x80\x02}(X\xff\xff\xff\x7f"]:
            self.refused(self.checkpoint(None, raw=raw), "")

    def test_random_damage_fails_cleanly_or_reads_tensors(self):
        good = self.checkpoint({"w": tensor("0", (4,)), "v": tensor("0", (2, 2))}, {"0": b"\0" * 16}).read_bytes()
        generator = np.random.default_rng(1)
        path = self.folder / "damaged.ckpt"
        for _ in range(500):
            content = bytearray(good)
            for place in generator.integers(len(content), size=4):
                content[place] = generator.integers(256)
            path.write_bytes(content)
            try:
                importer.read_checkpoint(path)
            except importer.CheckpointError:
                pass


class Writing(Case):
    def network(self, name, lobe_layers):
        encoder = {"intro.weight": (4, 3, 3, 3), "intro.bias": (4,), "ending.weight": (9, 4, 3, 3), "downs.0.weight": (8, 4, 2, 2), "encoders.0.0.beta": (1, 4, 1, 1)}
        decoder = {"middle_blks.0.beta": (1, 8, 1, 1), "ups.0.0.weight": (16, 8, 1, 1), "decoders.0.0.beta": (1, 4, 1, 1), **lobe_layers}
        paths = []
        for part, shapes in [("enc", encoder), ("dec", decoder)]:
            content = {f"module.{key}": tensor(str(i), shape) for i, (key, shape) in enumerate(shapes.items())}
            storages = {str(i): b"\0" * 4 * int(np.prod(shape)) for i, shape in enumerate(shapes.values())}
            paths.append(self.checkpoint(content, storages, f"{part}_{name}.ckpt"))
        return paths

    def test_header_and_configuration(self):
        out = self.folder / "out.safetensors"
        command = [sys.executable, TOOLS / "import_checkpoint.py", out, "--license", "ours", "--pair", *self.network("1", {})]
        subprocess.run(command, check=True)
        content = out.read_bytes()
        length = struct.unpack("<Q", content[:8])[0]
        header = json.loads(content[8 : 8 + length])
        metadata = header.pop("__metadata__")
        self.assertEqual(metadata["license"], "ours")
        self.assertEqual(
            json.loads(metadata["networks"]),
            [{"photos": 1, "width": 4, "encoder_blocks": [1], "middle_blocks": 1, "decoder_blocks": [1], "gcn": "none", "lobe": "isotropic", "roughness_floor": -0.3}],
        )
        self.assertIn("photos1.decoder.ups.0.0.weight", header)
        self.assertNotIn("photos1.encoder.ending.weight", header)
        self.assertEqual(max(entry["data_offsets"][1] for entry in header.values()), len(content) - 8 - length)
        self.assertEqual(metadata["version"], "2")
        self.assertTrue(checksums.verify(*checksums.read(out)[1:3]))

    def test_errors_are_one_line_and_name_the_file(self):
        missing = self.folder / "missing.ckpt"
        command = [sys.executable, TOOLS / "import_checkpoint.py", self.folder / "out", "--pair", missing, missing]
        result = subprocess.run(command, capture_output=True, text=True)
        self.assertEqual(result.returncode, 1)
        self.assertRegex(result.stderr, r"\Aimport_checkpoint: .*missing\.ckpt.*\n\Z")

    def test_networks_that_do_not_go_together(self):
        pair = self.network("1", {})
        aniso = self.network("2", {"tang_conv.end.weight": (3, 14, 3, 3)})
        for second in [pair, aniso]:
            networks = [importer.import_pair(*pair), importer.import_pair(*second)]
            with self.assertRaises(importer.CheckpointError):
                importer.write_weights(self.folder / "out", networks, "")


if __name__ == "__main__":
    unittest.main()
