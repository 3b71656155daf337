"""The network: order and number of photos, windows, size, and the fixture for other implementations."""

from pathlib import Path

import pytest
from conftest import NEEDED

torch = pytest.importorskip("torch", reason=NEEDED)

import fixture  # noqa: E402
from conftest import TINY  # noqa: E402

from svbrdf_gcn.training import model, store  # noqa: E402

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures" / "default"
CONFIG = {**model.DEFAULT, **TINY["model"], "window": 24}


@pytest.fixture
def network():
    """A small network with weights away from their initial zeros."""
    rng = torch.Generator().manual_seed(2)
    net = model.Model(CONFIG)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter += 0.2 * torch.randn(parameter.shape, generator=rng)
    return net.double()


def inputs(photos, height=24, width=24, seed=0):
    return torch.rand(2, photos, 13, height, width, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_the_order_of_photos_does_not_matter(network):
    x = inputs(5)
    with torch.no_grad():
        plain, turned = network(x), network(x[:, [3, 0, 4, 2, 1]])
    for a, b in zip(plain, turned):
        assert (a - b).abs().max() < 1e-10
    with torch.no_grad():
        assert (network(x[:, :4])[0] - plain[0]).abs().max() > 1e-3


@pytest.mark.parametrize("photos", [1, 2, 3, 9])
def test_any_number_of_photos(network, photos):
    with torch.no_grad():
        raw, log_sigma = network(inputs(photos, 20, 26))
    assert raw.shape == log_sigma.shape == (2, 9, 20, 26)
    assert torch.isfinite(raw).all() and log_sigma.min() >= -7 and log_sigma.max() <= 1


def test_the_local_form_is_the_global_one_at_the_size_of_training(network):
    x = inputs(3)
    with torch.no_grad():
        assert (network(x)[0] - network(x, None)[0]).abs().max() < 1e-10
        large = inputs(2, 48, 40)
        assert (network(large)[0] - network(large, None)[0]).abs().max() > 1e-4


@pytest.mark.parametrize("window", [4, 5, 9])
def test_window_means_are_means_over_windows(window):
    x = torch.rand(1, 2, 7, 12, dtype=torch.float64)
    means = model.window_mean(x, window)
    for row in range(7):
        for column in range(12):
            spans = [(min(max(i - min(window, n) // 2, 0), n - min(window, n)), min(window, n)) for i, n in ((row, 7), (column, 12))]
            (top, height), (left, width) = spans
            part = x[:, :, top : top + height, left : left + width].mean((2, 3))
            got = means[:, :, row if means.shape[2] > 1 else 0, column if means.shape[3] > 1 else 0]
            assert (got - part).abs().max() < 1e-12


def test_certainty_leaves_the_maps_alone(network):
    network(inputs(2))[1].sum().backward()
    assert network.certainty.end.weight.grad.abs().sum() > 0
    others = [p.grad for name, p in network.named_parameters() if not name.startswith("certainty.")]
    assert all(gradient is None or not gradient.any() for gradient in others)


def test_every_parameter_has_a_gradient(network):
    raw, log_sigma = network(inputs(3))
    (raw.square().sum() + log_sigma.square().sum()).backward()
    # A key's bias adds the same to all senders of a receiver, which the softmax ignores up to the product with the query.
    missing = [name for name, p in network.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert missing == []


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_half_precision_stays_near(network, layout):
    """As on a GPU: bfloat16 up to the tail, either memory layout."""
    network.float().to(memory_format=layout)
    network.memory_format = layout
    x = inputs(3).float()
    plain, _ = network(x, None)
    with torch.autocast("cpu", torch.bfloat16):
        raw, log_sigma = network(x, None)
    assert raw.dtype == log_sigma.dtype == torch.float32
    assert (raw - plain).abs().mean() < 0.1 * plain.std()
    (raw.square().mean() + log_sigma.mean()).backward()
    assert all(torch.isfinite(parameter.grad).all() for parameter in network.parameters())


def test_the_default_network_is_small():
    parameters, multiply_adds = model.cost(model.Model({**model.DEFAULT}))
    assert parameters <= 4_000_000
    assert multiply_adds <= 20e9


def expected_inputs(expected):
    return {name: expected[name] for name in ("photos", "saturated", "camera", "light", "intensity")}


def test_the_fixture_is_what_the_network_answers():
    stored, metadata = store.load(FIXTURES / "weights.safetensors")
    expected, _ = store.load(FIXTURES / "expected.safetensors")
    given, answers = fixture.made_up()[1], fixture.answers(stored, expected_inputs(expected))
    assert metadata["brdf"] == "paper" and set(expected) == set(given) | set(answers)
    for name, values in answers.items():
        assert (values - expected[name]).abs().max() < 1e-5, name
    # The fixture tells the forms apart.
    assert (expected["raw"] - expected["raw_global"]).abs().max() > 1e-3
    assert expected["maps"].std() > 0.05 and expected["log_sigma"].std() > 0.05
