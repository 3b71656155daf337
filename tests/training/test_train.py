"""Training goes on exactly where it stopped; exports hold what was trained."""

import json

import pytest
from conftest import NEEDED

torch = pytest.importorskip("torch", reason=NEEDED)

from svbrdf_gcn.training import bench, configuration, export, plot, sheet, store, train  # noqa: E402
from svbrdf_gcn.training.data import Batches, open_data  # noqa: E402
from svbrdf_gcn.training.model import Model  # noqa: E402


def run(trainer, steps):
    batches = Batches(open_data(trainer.config), trainer.device)
    return [float(trainer.descend(batches.take(trainer.step, trainer.phase()))["loss"]) for _ in range(steps)]


def test_resumed_training_gives_the_same_bits(config_file, tmp_path):
    config = configuration.load(config_file)
    device = torch.device("cpu")
    whole = train.Trainer(config, device)
    expected = run(whole, 6)
    first = train.Trainer(config, device)
    assert run(first, 4) == expected[:4]
    first.save(tmp_path)
    second = train.Trainer(config, device)
    second.load(tmp_path)
    assert run(second, 2) == expected[4:]
    for a, b in ((whole.named, second.named), (whole.average, second.average)):
        assert all(torch.equal(a[name], b[name]) for name in a)
    assert len(set(expected)) == 6


def test_a_call_trains_logs_validates_and_exports(config_file, packed, tmp_path, capsys):
    folder = tmp_path / "run"
    train.main([str(config_file), "-o", str(folder), "--device", "cpu"])
    assert "within sigma" in capsys.readouterr().out
    entries = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert [entry["step"] for entry in entries if "loss" in entry] == [1, 2, 3, 4, 5, 6]
    row = entries[-1]["validation"]["near 2"]
    assert {"D", "N", "R", "S", "rendering", "cover_normal"} <= set(row) and 0 < row["rendering"] < 1

    # A second call has nothing left to do.
    train.main([str(config_file), "-o", str(folder), "--device", "cpu"])
    state = json.loads((folder / "checkpoint" / "state.json").read_text())
    assert state["step"] == 6
    plot.main([str(folder), "-o", str(tmp_path / "log.png")])
    assert (tmp_path / "log.png").stat().st_size > 10_000

    average, _ = store.load(folder / "checkpoint" / "average.safetensors")
    assert store.load(folder / "weights.safetensors")[1]["license"] == "not stated"
    for flag, dtype in (([], torch.float16), (["--f32"], torch.float32)):
        export.main([str(folder), "-o", str(tmp_path / "w.safetensors"), "--device", "cpu", *flag])
        tensors, metadata = store.load(tmp_path / "w.safetensors")
        differing = [name for name in average if not torch.equal(tensors[name], average[name].to(dtype))]
        # The certainty is calibrated, nothing else is changed.
        assert differing == ["certainty.end.bias"] and len(tensors) == len(average)
        architecture = json.loads(metadata["architecture"])
        network = Model({key: architecture[key] for key in state["config"]["model"]})
        network.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
        assert json.loads(metadata["data"])["materials"] == 6 and metadata["roughness"] == "perceptual"
        assert json.loads(metadata["training"])["steps"] == 6
        assert metadata["version"] == "2" and set(json.loads(metadata["checksums"])["tensors"]) == set(tensors)


def test_a_flipped_bit_of_a_checkpoint_is_found(tmp_path):
    path = tmp_path / "values.safetensors"
    store.save(path, {"a": torch.arange(4.0), "b": torch.zeros(0)})
    assert torch.equal(store.load(path)[0]["a"], torch.arange(4.0))
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(SystemExit, match="tensor a: .*damaged"):
        store.load(path)


def test_time_ends_a_call_with_a_checkpoint(config_file, tmp_path):
    train.main([str(config_file), "-o", str(tmp_path / "run"), "--device", "cpu", "--seconds", "0", "--set", "steps=1000000"])
    assert json.loads((tmp_path / "run" / "checkpoint" / "state.json").read_text())["step"] == 0


def test_without_moments_the_optimiser_starts_afresh(config_file, tmp_path, capsys):
    config = configuration.load(config_file)
    trainer = train.Trainer(config, torch.device("cpu"))
    trainer.step = 3
    trainer.save(tmp_path)
    (tmp_path / "checkpoint" / "moment1.safetensors").unlink()
    other = train.Trainer(config, torch.device("cpu"))
    other.load(tmp_path)
    assert other.step == 3 and not other.optimiser.state and "afresh" in capsys.readouterr().out


def test_the_rate_rises_and_falls(config_file):
    config = configuration.load(config_file, ["steps=100", "optimiser.warmup=0.1"])
    trainer = train.Trainer(config, torch.device("cpu"))
    rates = []
    for trainer.step in range(101):
        rates.append(trainer.rate())
    assert rates.index(max(rates)) == 10 and abs(max(rates) - 1e-3) < 1e-5
    assert rates[0] < 1e-5 and abs(rates[-1] - 1e-6) < 1e-9
    assert configuration.phase_at(config, 0.49)["size"] == 24 and configuration.phase_at(config, 0.51)["size"] == 32
    assert config["model"]["window"] == 32


@pytest.mark.parametrize("change", ["stepps=3", "data.grups=2", 'seed="one"', "phase=[{share=0.5, size=8, batch=1}]"])
def test_wrong_settings_are_errors(config_file, change):
    with pytest.raises(ValueError, match="stepps|data.grups|seed|phase"):
        configuration.load(config_file, [change])


def test_training_from_weights_starts_where_they_end(config_file, tmp_path):
    train.main([str(config_file), "-o", str(tmp_path / "first"), "--device", "cpu"])
    weights = tmp_path / "first" / "weights.safetensors"
    trainer = train.Trainer(configuration.load(config_file), torch.device("cpu"))
    trainer.start_from(weights)
    for name, tensor in store.load(weights)[0].items():
        assert torch.equal(trainer.named[name].detach(), tensor.float()) and torch.equal(trainer.average[name], tensor.float())
    other = train.Trainer(configuration.load(config_file, ["model.stem=5"]), torch.device("cpu"))
    with pytest.raises(SystemExit, match="stem"):
        other.start_from(weights)


def test_a_library_is_packed_once(config_file, library, tmp_path):
    pack = tmp_path / "new" / "materials.zip"
    for steps in (1, 2):
        settings = ["--set", f'data.pack="{pack}"', "--set", f"steps={steps}"]
        train.main([str(config_file), "-o", str(tmp_path / f"run {steps}"), "--library", str(library), "--device", "cpu", *settings])
        made = pack.stat().st_mtime_ns
    assert pack.stat().st_mtime_ns == made
    settings[1] = 'data.pack="nowhere.zip"'
    with pytest.raises(SystemExit, match="nowhere.zip"):
        train.main([str(config_file), "-o", str(tmp_path / "run"), "--device", "cpu", *settings])


def test_losses_fall(config_file):
    config = configuration.load(config_file, ["steps=1000", "optimiser.rate=3e-3", "optimiser.warmup=0.0"])
    trainer = train.Trainer(config, torch.device("cpu"))
    batch = Batches(open_data(config), trainer.device).take(0, config["phase"][0])
    losses = [float(trainer.descend(batch)["loss"]) for _ in range(30)]
    assert losses[-1] < 0.8 * losses[0]


def test_broken_batches_leave_the_network_alone(config_file):
    config = configuration.load(config_file)
    trainer = train.Trainer(config, torch.device("cpu"))
    before = {name: tensor.detach().clone() for name, tensor in trainer.named.items()}
    batch = Batches(open_data(config), trainer.device).take(0, config["phase"][0])
    measured = trainer.descend({**batch, "inputs": batch["inputs"] * float("nan")})
    assert measured["skipped"] == 1 and trainer.step == 1
    assert all(torch.equal(before[name], tensor) for name, tensor in trainer.named.items())


def test_pictures_and_times(config_file, tmp_path, capsys):
    folder, picture = tmp_path / "run", tmp_path / "sheet.png"
    train.main([str(config_file), "-o", str(folder), "--device", "cpu"])
    for arguments in (["training", str(config_file), "--photos", "2"], ["kinds", "--size", "32"], ["validation", str(config_file), "--run", str(folder)]):
        sheet.main([*arguments, "-o", str(picture), "--device", "cpu"])
        assert picture.stat().st_size > 10_000
        picture.unlink()
    bench.main([str(config_file), "--steps", "1", "--device", "cpu"])
    assert "4 crops of 24" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["default", "continued", "large", "smoke", "directions"])
def test_the_committed_configurations_are_sound(name):
    config = configuration.load(name)
    model = Model(config["model"])
    grain = 2 ** (len(model.encoders) + 1)
    assert all(phase["size"] % grain == 0 for phase in config["phase"])
