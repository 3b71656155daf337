#!/usr/bin/env python3
"""Times the network at the released sizes in PyTorch on the CPU, random weights, 256 x 256: the figures beside which docs/performance.md puts ours.

Prints the least of several runs in milliseconds: decoder, and decoder with the gradient of the latent code. Needs PyTorch and numpy.
"""

import argparse
import time

import torch
import torch.nn.functional as F
from torch import nn


class Norm(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.weight = nn.Parameter(torch.ones(channels, 1, 1))
        self.bias = nn.Parameter(torch.zeros(channels, 1, 1))

    def forward(self, x):
        mean = x.mean(1, keepdim=True)
        variance = (x - mean).pow(2).mean(1, keepdim=True)
        return (x - mean) / (variance + 1e-6).sqrt() * self.weight + self.bias


def gate(x):
    a, b = x.chunk(2, 1)
    return a * b


class Block(nn.Module):
    def __init__(self, c):
        super().__init__()
        self.norm1, self.norm2 = Norm(c), Norm(c)
        self.conv1, self.conv4 = nn.Conv2d(c, 2 * c, 1), nn.Conv2d(c, 2 * c, 1)
        self.conv2 = nn.Conv2d(2 * c, 2 * c, 3, padding=1, groups=2 * c)
        self.sca, self.conv3, self.conv5 = nn.Conv2d(c, c, 1), nn.Conv2d(c, c, 1), nn.Conv2d(c, c, 1)
        self.beta, self.gamma = nn.Parameter(torch.full((c, 1, 1), 0.1)), nn.Parameter(torch.full((c, 1, 1), 0.1))

    def forward(self, x):
        branch = gate(self.conv2(self.conv1(self.norm1(x))))
        branch = branch * self.sca(F.adaptive_avg_pool2d(branch, 1))
        y = x + self.conv3(branch) * self.beta
        return y + self.conv5(gate(self.conv4(self.norm2(y)))) * self.gamma


class Decoder(nn.Module):
    def __init__(self, width=64, middle=12, blocks=(2, 2, 2, 2)):
        super().__init__()
        c = width << len(blocks)
        self.middle = nn.Sequential(*[Block(c) for _ in range(middle)])
        self.ups, self.levels = nn.ModuleList(), nn.ModuleList()
        for count in blocks:
            self.ups.append(nn.Sequential(nn.Conv2d(c, 2 * c, 1, bias=False), nn.PixelShuffle(2)))
            c //= 2
            self.levels.append(nn.Sequential(*[Block(c) for _ in range(count)]))
        self.ending = nn.Conv2d(width, 9, 3, padding=1)

    def forward(self, x, skips):
        x = self.middle(x)
        for up, level, skip in zip(self.ups, self.levels, skips):
            x = level(up(x) + skip)
        return self.ending(x)


def least(repeats, work):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--repeats", type=int, default=10)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(1)
    decoder = Decoder().requires_grad_(False)
    skips = [torch.randn(1, 1024 >> level, 16 << level, 16 << level) for level in range(1, 5)]
    z = torch.randn(1, 1024, 16, 16)

    def forward():
        with torch.no_grad():
            decoder(z, skips)

    def step():
        leaf = z.clone().requires_grad_(True)
        decoder(leaf, skips).pow(2).mean().backward()

    print(f"PyTorch {torch.__version__}, {options.threads} threads")
    print(f"decoder: {least(options.repeats, forward):.0f} ms")
    print(f"decoder and gradient of z: {least(options.repeats, step):.0f} ms")


if __name__ == "__main__":
    main()
