"""The network of Luo et al. 2024: photos in, raw maps out. It sees no positions; the number of photos is fixed.

Encoder: a graph convolution over the channels of all photos (paper, Eq. 2), then NAFNet levels, each followed by a 2x2 convolution of stride 2, down to the
latent code. Decoder: middle blocks on the latent code, NAFNet levels on the way up with the encoder's skips, a 3x3 convolution `ending` to the material
feature H of nine channels, one adapter per map (paper, Eq. 4). Tensors have the names of the released checkpoints behind `encoder.` and `decoder.`, those of
`core/src/nn/network.rs`, which runs and optimises what is trained here.

`gcn` says how the photos are fused; all but the first two are for the ablations.

- `full`: Eq. 2 as written, every channel gains from every other; `diagonal`: only from itself, as in the released weights.
- `none`: one convolution of all photos' channels.
- `max`: one convolution per photo and the maximum over photos, as in Deschaintre et al. 2019, then a convolution.

`adapters = false`: `ending` gives the nine raw planes itself.
"""

import torch
import torch.nn as nn
import torch.nn.functional as functional

from .model import ADAPTERS, Adapter, Block

GCN = ("full", "diagonal", "none", "max")
# Channels of the material feature.
FEATURE = 9

DEFAULT = {"photos": 4, "width": 64, "encoder_blocks": [2, 2, 4, 8], "middle_blocks": 12, "decoder_blocks": [2, 2, 2, 2], "gcn": "full", "adapters": True, "roughness_floor": -0.3}  # fmt: skip


def blocks(count, channels):
    return nn.ModuleList(Block(channels) for _ in range(count))


def run(chain, x):
    """`x` after blocks whose channel attention averages over the whole picture."""
    for block in chain:
        x = block(x, None)
    return x


class Encoder(nn.Module):
    """Photos (B, N, 3, H, W) to the latent code and the skips, finest first."""

    def __init__(self, config):
        super().__init__()
        width, photos, self.gcn = config["width"], config["photos"], config["gcn"]
        if self.gcn == "none":
            self.intro = nn.Conv2d(3 * photos, width, 3, padding=1)
        else:
            self.conv0 = nn.Conv2d(3, width if self.gcn == "max" else width // photos, 3, padding=1)
            self.conv1 = nn.Conv2d(width, width, 3, padding=1)
        if self.gcn in ("full", "diagonal"):
            self.conv_q1, self.conv_k1 = (nn.Conv2d(width, width, 3, padding=1) for _ in range(2))
            self.adj1 = nn.Parameter(torch.ones(width, width))
            # The sum over all channels stays as large as one of them.
            self.lamda = nn.Parameter(torch.tensor(1.0 if self.gcn == "diagonal" else 1.0 / width))
        levels = config["encoder_blocks"]
        self.encoders = nn.ModuleList(blocks(count, width << level) for level, count in enumerate(levels))
        self.downs = nn.ModuleList(nn.Conv2d(width << level, width << level + 1, 2, stride=2) for level in range(len(levels)))

    def fuse(self, photos):
        """The first features, (B, width, H, W)."""
        if self.gcn == "none":
            return self.intro(photos.flatten(1, 2))
        batch = len(photos)
        x = self.conv0(photos.flatten(0, 1)).reshape(batch, photos.shape[1], -1, *photos.shape[-2:])
        if self.gcn == "max":
            return functional.relu(self.conv1(x.amax(1)))
        x = x.flatten(1, 2)
        h = self.conv1(x)
        query, key = (layer(x).mean((-2, -1)) for layer in (self.conv_q1, self.conv_k1))
        adjacency = self.adj1 + torch.tanh(query[:, :, None] - key[:, None, :])
        if self.gcn == "diagonal":
            gathered = h * adjacency.diagonal(dim1=1, dim2=2)[..., None, None]
        else:
            gathered = torch.einsum("bihw,bij->bjhw", h, adjacency.to(h.dtype))
        return functional.relu(self.lamda * gathered)

    def forward(self, photos):
        x, skips = self.fuse(photos), []
        for chain, down in zip(self.encoders, self.downs):
            x = run(chain, x)
            skips.append(x)
            x = down(x)
        return x, skips


class Decoder(nn.Module):
    """Latent code and skips to raw maps (B, 9, H, W)."""

    def __init__(self, config):
        super().__init__()
        width, counts = config["width"], config["decoder_blocks"]
        coarse_first = range(len(counts) - 1, -1, -1)
        self.middle_blks = blocks(config["middle_blocks"], width << len(counts))
        self.ups = nn.ModuleList(nn.ModuleList([nn.Conv2d(width << level + 1, width << level + 2, 1, bias=False)]) for level in coarse_first)
        self.decoders = nn.ModuleList(blocks(count, width << level) for level, count in zip(coarse_first, counts))
        self.ending = nn.Conv2d(width, FEATURE, 3, padding=1)
        self.adapters = ADAPTERS if config["adapters"] else ()
        for name, outputs in self.adapters:
            setattr(self, name, Adapter(FEATURE, outputs))

    def forward(self, latent, skips):
        x = run(self.middle_blks, latent)
        for up, chain, skip in zip(self.ups, self.decoders, skips[::-1]):
            x = run(chain, functional.pixel_shuffle(up[0](x), 2) + skip)
        # In full precision: 8 bits of mantissa are too few for maps.
        full = self.ending.weight.dtype
        with torch.autocast(x.device.type, enabled=False):
            feature = self.ending(x.to(full))
            return torch.cat([getattr(self, name)(feature, None) for name, _ in self.adapters], 1) if self.adapters else feature


class Paper(nn.Module):
    """See the module's documentation. `config` is a dictionary with the keys of `DEFAULT`."""

    def __init__(self, config):
        super().__init__()
        if config["gcn"] not in GCN:
            raise ValueError(f"paper.gcn: expected one of {', '.join(GCN)}, got {config['gcn']}")
        if len(config["encoder_blocks"]) != len(config["decoder_blocks"]):
            raise ValueError(f"paper.decoder_blocks: expected {len(config['encoder_blocks'])} levels, got {len(config['decoder_blocks'])}")
        if config["width"] % config["photos"]:
            raise ValueError(f"paper.width: expected a multiple of {config['photos']} photos, got {config['width']}")
        self.config = dict(config)
        self.memory_format = torch.contiguous_format
        self.encoder, self.decoder = Encoder(config), Decoder(config)

    def forward(self, inputs, window=None):
        """Raw maps (B, 9, H, W) of inputs (B, N, 13, H, W), of which only the photos count; no certainty. `window` is not used: averages are global."""
        if inputs.shape[1] != self.config["photos"]:
            raise ValueError(f"inputs: expected {self.config['photos']} photos, got {inputs.shape[1]}")
        height, width = inputs.shape[-2:]
        grain = 2 ** len(self.config["encoder_blocks"])
        photos = functional.pad(inputs[:, :, :3], (0, -width % grain, 0, -height % grain))
        if self.memory_format == torch.channels_last:
            photos = torch.stack([photo.contiguous(memory_format=torch.channels_last) for photo in photos.unbind(1)], 1)
        return self.decoder(*self.encoder(photos))[..., :height, :width], None


def with_adapters(tensors):
    """The tensors of a network without adapters, with adapters that change nothing: such a file runs wherever the paper's networks do."""
    out, start = dict(tensors), 0
    for name, outputs in ADAPTERS:
        adapter = Adapter(FEATURE, outputs)
        with torch.no_grad():
            for parameter in adapter.parameters():
                parameter.zero_()
            for norm in (adapter.conv.norm1, adapter.conv.norm2):
                norm.weight.fill_(1)
            for plane in range(outputs):
                adapter.end.weight[plane, start + plane, 1, 1] = 1
        out.update({f"decoder.{name}.{key}": value for key, value in adapter.state_dict().items()})
        start += outputs
    return out
