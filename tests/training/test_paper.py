"""The paper's network: the released architecture's answers, its forms, a training of it, and its export."""

import json
from pathlib import Path

import pytest
from conftest import NEEDED

torch = pytest.importorskip("torch", reason=NEEDED)

from svbrdf_gcn.training import configuration, export, model, paper, store, train  # noqa: E402

OFFICIAL = Path(__file__).resolve().parents[3] / "shared" / "fixtures" / "official"
# What the released network looks like in those fixtures.
RELEASED = {**paper.DEFAULT, "encoder_blocks": [1, 1], "middle_blocks": 1, "decoder_blocks": [1, 1]}
SMALL = {**RELEASED, "width": 8}


def released(gcn):
    """The network with the weights of the fixtures, in double precision."""
    net = paper.Paper({**RELEASED, "gcn": gcn}).double()
    tensors = {}
    for part, file in (("encoder", "enc_4.ckpt"), ("decoder", "dec.ckpt")):
        loaded = torch.load(OFFICIAL / file, map_location="cpu", weights_only=True)
        tensors |= {f"{part}.{name.removeprefix('module.')}": value for name, value in loaded.items()}
    shapes = {name: value.shape for name, value in net.state_dict().items()}
    assert set(shapes) == {name for name in tensors if not name.startswith("encoder.ending")}
    # The released files keep beta and gamma with dimensions of one.
    net.load_state_dict({name: tensors[name].reshape(shape) for name, shape in shapes.items()})
    return net


@pytest.mark.skipif(not OFFICIAL.exists(), reason=f"the fixtures in {OFFICIAL} are not part of the project")
@pytest.mark.parametrize(("gcn", "prefix"), [("diagonal", "gcn"), ("full", "gcn_full")])
def test_the_released_architecture(gcn, prefix):
    expected, _ = store.load(OFFICIAL / "expected.safetensors")
    images = expected["images"].double()[None]
    inputs = torch.cat([images, torch.zeros(1, 4, 10, *images.shape[-2:], dtype=torch.float64)], 2)
    net = released(gcn)
    with torch.no_grad():
        latent, _ = net.encoder(images)
        raw, certainty = net(inputs)
    assert certainty is None
    for ours, name in ((latent, f"{prefix}_latent"), (raw, f"{prefix}_maps")):
        theirs = expected[name].reshape(ours.shape)
        assert (ours - theirs).abs().max() < 1e-9 * max(1.0, float(theirs.abs().max())), name


@pytest.mark.parametrize("gcn", paper.GCN)
@pytest.mark.parametrize("adapters", [True, False])
def test_forms_and_sizes(gcn, adapters):
    net = paper.Paper({**SMALL, "gcn": gcn, "adapters": adapters})
    raw, _ = net(torch.rand(2, 4, 13, 22, 17))
    assert raw.shape == (2, 9, 22, 17)
    raw.sum().backward()
    with pytest.raises(ValueError, match="4 photos, got 3"):
        net(torch.rand(1, 3, 13, 16, 16))


def test_max_pooling_does_not_know_the_order_of_photos():
    net, x = paper.Paper({**SMALL, "gcn": "max"}), torch.rand(1, 4, 13, 16, 16)
    with torch.no_grad():
        assert (net(x)[0] - net(x[:, [2, 0, 3, 1]])[0]).abs().max() < 1e-5


def test_the_cost_is_the_paper_s():
    parameters, multiply_adds = model.cost(paper.Paper(paper.DEFAULT), size=64)
    assert 115e6 < parameters < 117e6
    assert multiply_adds > 1e9


def test_adapters_that_change_nothing():
    config = {**SMALL, "adapters": False}
    plain, full, x = paper.Paper(config), paper.Paper(SMALL), torch.rand(1, 4, 13, 16, 16)
    full.load_state_dict(paper.with_adapters(plain.state_dict()))
    with torch.no_grad():
        assert (plain(x)[0] - full(x)[0]).abs().max() < 1e-5


def test_a_training_and_its_export(packed, tmp_path):
    text = f"""
network = "paper"
steps = 2
photos = [0, 0, 0, 1]
[paper]
width = 8
encoder_blocks = [1, 1]
middle_blocks = 1
decoder_blocks = [1, 1]
[data]
pack = "{packed}"
captures = "paper"
groups = 3
per_group = 2
size = 48
[[phase]]
share = 1.0
size = 24
batch = 2
[validation]
size = 32
photos = [4]
views = 2
"""
    config = tmp_path / "paper.toml"
    config.write_text(text)
    train.main([str(config), "-o", str(tmp_path / "run"), "--device", "cpu"])
    log = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert list(log[-1]["validation"]) == ["paper 4"]
    assert (tmp_path / "run" / "weights.safetensors").exists()
    export.main([str(tmp_path / "run"), "-o", str(tmp_path / "w.safetensors"), "--f32", "--device", "cpu"])
    tensors, metadata = store.load(tmp_path / "w.safetensors")
    (network,) = json.loads(metadata["networks"])
    assert (network["gcn"], network["width"], network["lobe"]) == ("full", 8, "isotropic")
    assert "photos4.encoder.adj1" in tensors and "photos4.decoder.spec_conv.end.bias" in tensors
    with pytest.raises(SystemExit, match="max"):
        export.paper_network({**SMALL, "gcn": "max"})


def test_wrong_configurations_are_refused(tmp_path):
    for text, message in (
        ('network = "other"', "network: expected one of"),
        ('[data]\ncaptures = "some"', "data.captures: expected one of"),
        ('network = "paper"', "captures of 4 photos alone"),
    ):
        path = tmp_path / "bad.toml"
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            configuration.load(path)
    for changes, message in (({"gcn": "mean"}, "paper.gcn"), ({"width": 10}, "multiple of 4"), ({"decoder_blocks": [1]}, "expected 2 levels")):
        with pytest.raises(ValueError, match=message):
            paper.Paper({**SMALL, **changes})


@pytest.mark.parametrize("width", [16, 32, 64])
def test_the_files_of_the_paper_s_network(width):
    path = Path(paper.__file__).with_name(f"paper-{width}.toml")
    assert configuration.load(path)["paper"]["width"] == width
    one = ["paper.photos=1", 'paper.gcn="none"', "photos=[1]", "validation.photos=[1]"]
    assert configuration.load(path, one)["paper"]["photos"] == 1
