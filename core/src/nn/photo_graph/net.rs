//! The photo graph, put together from operations; no gradients.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::config::{HINTS, LOG_SIGMA, PhotoGraphConfig};
use super::hints::Hints;
use super::rounds::{DIRECTIONS, Node, Pooling, Round};
use crate::error::{Error, Result};
use crate::nn::config::ISOTROPIC_ADAPTERS;
use crate::nn::layout::Layout;
use crate::nn::nafnet::{Block, Layer, block_within};
use crate::nn::network::{Blocks, Source, blocks, layer};
use crate::nn::ops::{conv3x3, pixel_shuffle, pixel_unshuffle, pointwise};
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Param, Planes, Pool};
use crate::progress::Control;

/// First plane of a photo's directions.
pub(super) const FIRST_DIRECTION: usize = 7;

/// A block and a 3x3 convolution.
pub(super) struct Adapter<E: Scalar> {
    pub block: Block<E>,
    pub end: Layer<E>,
}

impl<E: Scalar> Adapter<E> {
    fn new(get: &mut Source<'_, E>, name: &str, channels: usize) -> Result<Self> {
        let block = Block::new(channels, |tensor| get(&format!("{name}.conv.{tensor}")))?;
        Ok(Self { block, end: layer(get, &format!("{name}.end"))? })
    }

    fn run(&self, x: Planes<E>, window: Option<usize>) -> Result<Planes<E>> {
        conv3x3(relaxed(block_within(x, &self.block, window)?), 1, &self.end.weight, &self.end.bias).map(relaxed)
    }
}

/// A level of the trunk: blocks, the way down, the way up, blocks.
pub(super) struct Level<E: Scalar> {
    pub encoder: Blocks<E>,
    pub down: Layer<E>,
    pub up: Param<E>,
    pub decoder: Blocks<E>,
}

/// The layers of a photo graph; the names are those of a weights file.
pub(super) struct Net<E: Scalar> {
    pub intro: Layer<E>,
    pub stem: Blocks<E>,
    pub fold: Layer<E>,
    pub node: Blocks<E>,
    pub rounds: Vec<Round<E>>,
    pub entry: Layer<E>,
    /// Half resolution first.
    pub levels: Vec<Level<E>>,
    pub middle: Blocks<E>,
    pub unfold: Param<E>,
    pub skip: Layer<E>,
    pub tail: Blocks<E>,
    pub ending: Layer<E>,
    pub adapters: Vec<Adapter<E>>,
    pub certainty: Adapter<E>,
}

/// What a run gives: planes of the size that was asked for, one after the other.
pub(super) struct Output<E> {
    pub raw: Vec<E>,
    pub log_sigma: Vec<E>,
}

/// A 2x2 convolution of stride 2.
pub(super) fn half<E: Scalar, T: Tape<E, Cpu>>(x: Planes<E, T>, layer: &Layer<E>) -> Result<Planes<E, T>> {
    pointwise(pixel_unshuffle(x)?, &layer.weight, Some(&layer.bias))
}

fn run_blocks<E: Scalar>(
    mut x: Planes<E>,
    blocks: &Blocks<E>,
    window: Option<usize>,
    control: &mut Control<'_>,
) -> Result<Planes<E>> {
    for block in blocks {
        control.poll()?;
        x = relaxed(block_within(x, block, window)?);
    }
    Ok(x)
}

/// `x`, after giving back what the operation that made it has freed: what operations of other sizes leave would add up.
fn relaxed<E: Scalar>(x: Planes<E>) -> Planes<E> {
    x.pool().release();
    x
}

/// Pooled features at full resolution, hints at half resolution, and the photos' nodes.
type Seen<E> = (Planes<E>, Planes<E>, Vec<Node<E>>);

impl<E: Scalar> Net<E> {
    /// The network whose parameters `get` gives by name.
    pub fn new(config: &PhotoGraphConfig, get: &mut Source<'_, E>) -> Result<Self> {
        let levels = config.levels();
        let level = |level: usize| {
            let (step, channels, count) = (levels - 1 - level, config.channels(level), config.blocks[level]);
            Ok(Level {
                encoder: blocks(get, &format!("encoders.{level}"), count, channels)?,
                down: layer(get, &format!("downs.{level}"))?,
                up: get(&format!("ups.{step}.0.weight"))?,
                decoder: blocks(get, &format!("decoders.{step}"), count, channels)?,
            })
        };
        let levels = (0..levels).map(level).collect::<Result<_>>()?;
        let rounds = (0..config.rounds).map(|round| Round::new(config, get, &format!("rounds.{round}")));
        let rounds = rounds.collect::<Result<_>>()?;
        let adapters = ISOTROPIC_ADAPTERS.map(|(name, _)| Adapter::new(get, name, config.feature));
        let adapters = adapters.into_iter().collect::<Result<_>>()?;
        Ok(Self {
            intro: layer(get, "intro")?,
            stem: blocks(get, "stem", config.stem_blocks, config.stem)?,
            fold: layer(get, "fold")?,
            node: blocks(get, "node", 1, config.node)?,
            rounds,
            entry: layer(get, "entry")?,
            levels,
            middle: blocks(get, "middle_blks", config.middle, config.channels(config.levels()))?,
            unfold: get("unfold.weight")?,
            skip: layer(get, "skip")?,
            tail: blocks(get, "tail", config.tail_blocks, config.tail)?,
            ending: layer(get, "ending")?,
            adapters,
            certainty: Adapter::new(get, "certainty", config.tail)?,
        })
    }

    /// Raw maps and the logarithm of their standard deviations, of `photos` photos.
    ///
    /// `layout` is that of a photo's planes: sides that are multiples of [`PhotoGraphConfig::grain`]. `photo` gives the planes of each; they are asked for
    /// once, in order, and let go. `size`: rows and columns of what comes out.
    pub fn run(
        &self,
        config: &PhotoGraphConfig,
        photos: usize,
        layout: Layout,
        size: (usize, usize),
        mut photo: impl FnMut(usize, &Pool<E>) -> Result<Planes<E>>,
        control: &mut Control<'_>,
    ) -> Result<Output<E>> {
        let pool = Pool::default();
        let (fine, hints, nodes) =
            self.see(config, photos, layout, &mut |index| photo(index, &pool), &pool, control)?;
        let at_half = half_layout(layout).with_channels(config.node);
        let coarse = self.exchange(config, nodes, &hints, at_half, &pool, control)?;
        let (raw, log_sigma) = self.restore(config, fine, coarse, control)?;
        let unpack = |planes: &Planes<E>| planes.layout.unpack(planes.values(), size.0, size.1);
        Ok(Output { raw: raw.iter().flat_map(unpack).collect(), log_sigma: unpack(&log_sigma) })
    }

    /// Every photo by itself: what the pooled features of full resolution add to the tail, the hints at half resolution, and the nodes.
    fn see(
        &self,
        config: &PhotoGraphConfig,
        photos: usize,
        layout: Layout,
        photo: &mut dyn FnMut(usize) -> Result<Planes<E>>,
        pool: &Pool<E>,
        control: &mut Control<'_>,
    ) -> Result<Seen<E>> {
        let mut fine = Pooling::new(layout.with_channels(config.stem), pool);
        let mut hints = Hints::new(layout, pool);
        let mut nodes = Vec::with_capacity(photos);
        for index in 0..photos {
            control.poll()?;
            let x = photo(index)?;
            if x.layout != layout {
                return Err(Error::shape("planes of a photo", format!("{layout:?}"), format!("{:?}", x.layout)));
            }
            hints.add(x.values());
            let directions = halved(&x, FIRST_DIRECTION, DIRECTIONS)?;
            let x = relaxed(conv3x3(x, 1, &self.intro.weight, &self.intro.bias)?);
            let x = run_blocks(x, &self.stem, config.window_at(0), control)?;
            fine.add(x.values());
            let x = run_blocks(relaxed(half(x, &self.fold)?), &self.node, config.window_at(1), control)?;
            nodes.push(Node { features: x.into_buffer(), directions: directions.into_buffer() });
        }
        pool.release();
        let hints = hints.finish(pool)?;
        let fine = fine.finish(&hints)?;
        let hints = halved(&hints, 0, HINTS)?;
        let fine = pointwise(fine, &self.skip.weight, Some(&self.skip.bias))?;
        pool.release();
        Ok((fine, hints, nodes))
    }

    /// The rounds of messages: pooled features at half resolution, with the `hints` there.
    fn exchange(
        &self,
        config: &PhotoGraphConfig,
        mut nodes: Vec<Node<E>>,
        hints: &Planes<E>,
        layout: Layout,
        pool: &Pool<E>,
        control: &mut Control<'_>,
    ) -> Result<Planes<E>> {
        for round in &self.rounds {
            control.poll()?;
            round.exchange(&mut nodes, layout, pool);
            let through_block = |Node { features, directions }| {
                control.poll()?;
                let features = Planes::of(features, layout)?;
                let features = relaxed(block_within(features, &round.block, config.window_at(1))?);
                Ok(Node { features: features.into_buffer(), directions })
            };
            nodes = nodes.into_iter().map(through_block).collect::<Result<_>>()?;
        }
        let mut coarse = Pooling::new(layout, pool);
        for node in nodes {
            coarse.add(&node.features);
        }
        pool.release();
        coarse.finish(hints)
    }

    /// Raw maps of each adapter and the logarithm of their standard deviations, from what the photos gave at full and at half resolution.
    fn restore(
        &self,
        config: &PhotoGraphConfig,
        fine: Planes<E>,
        coarse: Planes<E>,
        control: &mut Control<'_>,
    ) -> Result<(Vec<Planes<E>>, Planes<E>)> {
        let mut x = relaxed(pointwise(coarse, &self.entry.weight, Some(&self.entry.bias))?);
        let mut skips = Vec::with_capacity(self.levels.len());
        for (depth, level) in self.levels.iter().enumerate() {
            x = run_blocks(x, &level.encoder, config.window_at(depth + 1), control)?;
            skips.push(x.branch());
            x = relaxed(half(x, &level.down)?);
        }
        x = run_blocks(x, &self.middle, config.window_at(self.levels.len() + 1), control)?;
        for ((depth, level), skip) in self.levels.iter().enumerate().zip(skips).rev() {
            x = relaxed(pixel_shuffle(pointwise(x, &level.up, None)?, Some(skip))?);
            x = run_blocks(x, &level.decoder, config.window_at(depth + 1), control)?;
        }
        x = relaxed(pixel_shuffle(pointwise(x, &self.unfold, None)?, Some(fine))?);
        let window = config.window_at(0);
        x = run_blocks(x, &self.tail, window, control)?;
        control.poll()?;
        let mut log_sigma = self.certainty.run(x.branch(), window)?.into_buffer();
        log_sigma.par_iter_mut().for_each(|value| *value = bounded_log_sigma(*value));
        let log_sigma = Planes::of(log_sigma, x.layout.with_channels(super::config::RAW_PLANES))?;
        let feature = relaxed(conv3x3(x, 1, &self.ending.weight, &self.ending.bias)?);
        let adapt = |adapter: &Adapter<E>| {
            control.poll()?;
            adapter.run(feature.branch(), window)
        };
        Ok((self.adapters.iter().map(adapt).collect::<Result<_>>()?, log_sigma))
    }
}

/// A logarithm of a standard deviation within its bounds; not a number stays what it is.
pub(super) fn bounded_log_sigma<E: Scalar>(value: E) -> E {
    let (low, high) = (E::splat(LOG_SIGMA[0]), E::splat(LOG_SIGMA[1]));
    if value < low {
        low
    } else if value > high {
        high
    } else {
        value
    }
}

/// The layout of half the resolution.
fn half_layout(layout: Layout) -> Layout {
    Layout { height: layout.height / 2, width: layout.width / 2, ..layout }
}

/// Planes `first..first + count`, averaged over 2x2 pixels.
pub(super) fn halved<E: Scalar>(x: &Planes<E>, first: usize, count: usize) -> Result<Planes<E>> {
    let (from, quarter) = (x.layout, E::splat(0.25));
    let to = half_layout(from).with_channels(count);
    let mut out = x.pool().take(to.len());
    out.par_chunks_mut(to.band_len()).enumerate().for_each(|(band, out)| {
        let rows = to.band_rows(band);
        for (line, out) in out.chunks_exact_mut(to.width).enumerate() {
            let (channel, row) = (first + line / rows.len(), 2 * (rows.start + line % rows.len()));
            let (upper, lower) = (&x.values()[from.row(channel, row)], &x.values()[from.row(channel, row + 1)]);
            for (out, (a, b)) in out.iter_mut().zip(upper.chunks_exact(2).zip(lower.chunks_exact(2))) {
                *out = (a[0] + a[1] + b[0] + b[1]) * quarter;
            }
        }
    });
    Planes::of(out, to)
}
