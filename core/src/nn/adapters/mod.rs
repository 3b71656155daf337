//! The per-map adapters: from the material feature to the raw maps, with the gradients of parameters and feature.
//!
//! An adapter is one NAFNet block on the m channels of the material feature (9, anisotropic 14) and a 3x3 convolution to its planes.
//! m is far too small for the usual detour over matrix products, and at 256 x 256 every intermediate plane kept costs more to write and
//! read again than to compute twice. So the work is done row by row, in four passes that each keep to the caches:
//!
//! 1. conv1, the depthwise conv2 and the gate. The gate's result is kept, its mean over the image gives the channel attention.
//! 2. everything behind it, to the raw planes.
//! 3. backward, as far as the gate: the same forward steps again and their gradients. The gradient at the gate is kept.
//!    What the attention adds to it is a constant per channel, known only after the whole image.
//! 4. backward from the gate to the feature, with conv1 and conv2 computed again.
//!
//! The image is cut into chunks of rows of fixed size, so sums do not depend on how many threads there are. All adapters pass over a
//! chunk while its part of the feature is in the cache, and every other pass goes backwards, from what the one before it left there.

#[allow(unsafe_code)]
mod buffer;
mod kernels;
mod layers;

use std::array;
use std::cmp::Reverse;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use self::buffer::Buffer;
use self::kernels::{Dense, Rows, Window};
use self::layers::{Layers, Sum, Sums, sum_lengths};
use crate::error::{Error, Result};
use crate::nn::AdapterParams;
use crate::real::LANES_MAX;

/// Rows of a chunk. A chunk computes up to two rows beyond its ends again.
const CHUNK: usize = 32;

/// Pixels of a tile of a row: what passes 2 and 3 hold of one tile fits the first-level cache.
const TILE: usize = 128;

/// Adapters over one material feature, with the memory their passes need.
///
/// ```
/// use svbrdf_gcn::nn::{AdapterParams, Adapters};
///
/// let (width, height, channels, outputs) = (20, 12, 9, [3, 1]);
/// let feature = vec![0.5; channels * width * height];
/// let params = vec![0.1; outputs.iter().map(|&k| AdapterParams::len_for(channels, k)).sum()];
/// let mut adapters = Adapters::new(&feature, channels, &outputs, width, height)?;
/// let mut raw = vec![0.0; 4 * width * height];
/// adapters.forward(&params, &mut raw)?;
/// let mut gradient = vec![0.0; params.len()];
/// adapters.backward(&raw, Some(&mut gradient), None)?; // of the sum of raw^2 / 2
/// # Ok::<(), svbrdf_gcn::Error>(())
/// ```
pub struct Adapters {
    shape: Shape,
    outputs: Vec<usize>,
    /// Where the rows of up to 2 m channels begin in kept rows, and in rows of a tile.
    wide: Vec<usize>,
    narrow: Vec<usize>,
    /// The feature, its channels normalised per pixel, and the factor of that: [row][channel][column].
    feature: Buffer,
    normal: Buffer,
    scale: Buffer,
    layers: Vec<Layers>,
    /// Result of the gate and its gradient, [adapter][row][channel][column].
    gates: Buffer,
    gate_gradients: Buffer,
    /// Gradient of the feature per adapter, likewise; empty until asked for.
    feature_gradients: Buffer,
    pool: Pool,
}

/// Sizes all passes need.
#[derive(Clone, Copy)]
struct Shape {
    channels: usize,
    width: usize,
    height: usize,
    /// Columns, rounded up to whole vectors. Kept columns beyond the width are zero.
    stride: usize,
}

impl Shape {
    /// Values from one row of rows-with-padding to the next.
    fn padded(self) -> usize {
        self.stride + LANES_MAX
    }

    /// Values of `channels` padded rows: every row has at least one zero on either side.
    fn slot(self, channels: usize) -> usize {
        channels * self.padded() + 2 * LANES_MAX
    }

    /// Values of a row of all channels.
    fn row(self) -> usize {
        self.channels * self.stride
    }

    /// Zeros the columns beyond the width in rows that are `stride` apart.
    fn clear_tails(self, rows: &mut [f32], stride: usize, count: usize) {
        if self.width < self.stride {
            for row in 0..count {
                rows[row * stride + self.width..row * stride + self.stride].fill(0.0);
            }
        }
    }
}

/// A few padded rows of all channels, row `r` of the picture in slot `r mod slots`.
struct Ring {
    values: Buffer,
    slot: usize,
    slots: usize,
}

impl Ring {
    fn new(shape: Shape, channels: usize, slots: usize) -> Self {
        let slot = shape.slot(channels);
        Self { values: Buffer::new(slots * slot), slot, slots }
    }

    /// Where the first value of row `row` (-1 and beyond the height included) lies.
    fn at(&self, row: isize) -> usize {
        row.rem_euclid(self.slots as isize) as usize * self.slot + LANES_MAX
    }

    /// The values from the first of row `row` on.
    fn row_mut(&mut self, row: isize) -> &mut [f32] {
        let at = self.at(row);
        &mut self.values[at..at - LANES_MAX + self.slot]
    }

    /// Places of the nine neighbours of the first pixel of row `row`, for each of `channels` channels: (channel, tap).
    /// With `flip`, of the pixels whose neighbour it is.
    fn neighbours(&self, row: isize, channels: usize, padded: usize, flip: bool, places: &mut Vec<usize>) {
        places.clear();
        for channel in 0..channels {
            for tap in 0..9 {
                let tap = if flip { 8 - tap } else { tap };
                places.push(self.at(row + tap as isize / 3 - 1) + channel * padded + tap % 3 - 1);
            }
        }
    }
}

/// Rows of one tile, [channel][column of the tile].
struct Tile {
    /// Input of the second half of the block, and that normalised with its factor.
    middle: Buffer,
    normal: Buffer,
    scale: Buffer,
    /// conv4 and the gate behind it.
    conv4: Buffer,
    gate: Buffer,
    /// Result of the block.
    out: Buffer,
    /// Gradients of the above.
    d_out: Buffer,
    d_gate: Buffer,
    d_conv4: Buffer,
    d_normal: Buffer,
}

/// What one chunk of one adapter needs while it is worked on.
struct Scratch {
    conv1: Ring,
    /// Gradient of conv2's result.
    d_conv2: Ring,
    out: Ring,
    d_raw: Ring,
    /// Two rows of conv2's result, then of the gradient of conv1's.
    conv2: Buffer,
    d_conv1: Buffer,
    d_normal: Buffer,
    raw: Buffer,
    tile: Tile,
    places: Vec<usize>,
    sums: [Buffer; 6],
}

impl Scratch {
    fn new(shape: Shape, outputs: usize) -> Self {
        let m = shape.channels;
        let tile = |channels: usize| Buffer::new(channels * TILE);
        Self {
            conv1: Ring::new(shape, 2 * m, 4),
            d_conv2: Ring::new(shape, 2 * m, 4),
            out: Ring::new(shape, m, 3),
            d_raw: Ring::new(shape, outputs, 3),
            conv2: Buffer::new(2 * 2 * shape.row()),
            d_conv1: Buffer::new(2 * 2 * shape.row()),
            d_normal: Buffer::new(shape.row()),
            raw: Buffer::new(outputs * shape.stride),
            tile: Tile {
                middle: tile(m),
                normal: tile(m),
                scale: tile(1),
                conv4: tile(2 * m),
                gate: tile(m),
                out: tile(m),
                d_out: tile(m),
                d_gate: tile(m),
                d_conv4: tile(2 * m),
                d_normal: tile(m),
            },
            places: Vec::new(),
            sums: sum_lengths(m, outputs).map(|len| Buffer::new(len * LANES_MAX)),
        }
    }

    /// The sums over lanes of what was gathered since the last call.
    fn take_sums(&mut self) -> Sums {
        array::from_fn(|i| {
            let sums =
                self.sums[i].chunks_exact(LANES_MAX).map(|lanes| lanes.iter().map(|&lane| f64::from(lane)).sum());
            let sums = sums.collect();
            self.sums[i].fill(0.0);
            sums
        })
    }
}

/// Scratch memory that chunks take and give back.
struct Pool {
    shape: Shape,
    outputs: usize,
    free: Mutex<Vec<Scratch>>,
}

impl Pool {
    fn with<T>(&self, work: impl FnOnce(&mut Scratch) -> T) -> T {
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let scratch = free().pop();
        let mut scratch = scratch.unwrap_or_else(|| Scratch::new(self.shape, self.outputs));
        let result = work(&mut scratch);
        free().push(scratch);
        result
    }
}

impl Adapters {
    /// Adapters with `outputs[i]` planes each over a feature of `channels` planes of `height` x `width` values, rows from the top.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if `feature` has another length; [`Error::InvalidArgument`] if a size or `outputs` is zero.
    pub fn new(feature: &[f32], channels: usize, outputs: &[usize], width: usize, height: usize) -> Result<Self> {
        if channels == 0 || width == 0 || height == 0 || outputs.is_empty() || outputs.contains(&0) {
            let reason = format!("{channels} channels of {height} x {width} to {outputs:?} planes: nothing may be 0");
            return Err(Error::invalid("adapters", reason));
        }
        let shape = Shape { channels, width, height, stride: width.next_multiple_of(LANES_MAX) };
        let kept = height * shape.row();
        let mut adapters = Self {
            shape,
            outputs: outputs.to_vec(),
            wide: (0..2 * channels).map(|channel| channel * shape.stride).collect(),
            narrow: (0..2 * channels).map(|channel| channel * TILE).collect(),
            feature: Buffer::new(kept),
            normal: Buffer::new(kept),
            scale: Buffer::new(height * shape.stride),
            layers: Vec::new(),
            gates: Buffer::new(outputs.len() * kept),
            gate_gradients: Buffer::new(outputs.len() * kept),
            feature_gradients: Buffer::default(),
            pool: Pool {
                shape,
                outputs: outputs.iter().copied().max().unwrap_or_default(),
                free: Mutex::new(Vec::new()),
            },
        };
        adapters.set_feature(feature)?;
        Ok(adapters)
    }

    /// Puts another feature of the same shape in place; [`Adapters::forward`] must run before the next [`Adapters::backward`].
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if `feature` has another length.
    pub fn set_feature(&mut self, feature: &[f32]) -> Result<()> {
        let Shape { channels, width, height, stride } = self.shape;
        check_len("feature", channels * height * width, feature.len())?;
        self.layers.clear();
        let shape = self.shape;
        let rows = self.feature.par_chunks_mut(shape.row()).zip(self.normal.par_chunks_mut(shape.row()));
        rows.zip(self.scale.par_chunks_mut(stride)).enumerate().for_each(|(row, ((target, normal), scale))| {
            for (channel, target) in target.chunks_mut(stride).enumerate() {
                target[..width].copy_from_slice(&feature[(channel * height + row) * width..][..width]);
            }
            kernels::normalize(channels, target, normal, stride, scale, stride);
            shape.clear_tails(normal, stride, channels);
        });
        Ok(())
    }

    /// Number of parameters of all adapters.
    pub fn params_len(&self) -> usize {
        self.outputs.iter().map(|&k| AdapterParams::len_for(self.shape.channels, k)).sum()
    }

    /// Number of values of the raw planes of all adapters.
    pub fn raw_len(&self) -> usize {
        self.outputs.iter().sum::<usize>() * self.shape.height * self.shape.width
    }

    /// Computes the raw planes of all adapters, one after the other, from `params`, the values of
    /// [`AdapterParams`](AdapterParams::values) of all adapters one after the other.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if a length differs from [`Adapters::params_len`] or [`Adapters::raw_len`].
    pub fn forward(&mut self, params: &[f32], raw: &mut [f32]) -> Result<()> {
        check_len("params", self.params_len(), params.len())?;
        check_len("raw", self.raw_len(), raw.len())?;
        let Shape { channels, width, height, .. } = self.shape;
        let mut rest = params;
        self.layers = (self.outputs.iter())
            .map(|&k| {
                let (params, others) = rest.split_at(AdapterParams::len_for(channels, k));
                rest = others;
                Layers::new(channels, k, params)
            })
            .collect();
        self.gate();

        let pixels = width * height;
        let mut planes = raw.chunks_mut(pixels);
        let mut tasks = Vec::new();
        for (adapter, &k) in self.outputs.iter().enumerate() {
            let planes = planes.by_ref().take(k).map(|plane| plane.chunks_mut(CHUNK * width));
            for (chunk, rows) in transpose(planes).into_iter().enumerate() {
                tasks.push((adapter, chunk, rows));
            }
        }
        tasks.sort_by_key(|task| Reverse(task.1));
        tasks.into_par_iter().with_max_len(1).for_each(|(adapter, chunk, planes)| {
            self.pool.with(|scratch| self.finish_chunk(adapter, chunk, planes, scratch));
        });
        Ok(())
    }

    /// The gradients of a loss with respect to the parameters and the feature, where asked for, at the feature and parameters of the last
    /// [`Adapters::forward`], given its gradient `d_raw` with respect to the raw planes. Both are overwritten.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if a length differs from that of raw planes, parameters or feature;
    /// [`Error::InvalidArgument`] if there was no forward pass with this feature.
    pub fn backward(
        &mut self,
        d_raw: &[f32],
        d_params: Option<&mut [f32]>,
        d_feature: Option<&mut [f32]>,
    ) -> Result<()> {
        let Shape { channels, width, height, stride } = self.shape;
        check_len("d_raw", self.raw_len(), d_raw.len())?;
        if let Some(d_params) = &d_params {
            check_len("d_params", self.params_len(), d_params.len())?;
        }
        if let Some(d_feature) = &d_feature {
            check_len("d_feature", channels * height * width, d_feature.len())?;
        }
        if self.layers.is_empty() {
            return Err(Error::invalid("backward", "expected a forward pass with this feature before, found none"));
        }
        let wants = Wants { params: d_params.is_some(), feature: d_feature.is_some() };
        let mut sums = self.back_to_gate(d_raw, wants);
        let pixels = (width * height) as f64;
        let offsets: Vec<Vec<f32>> = (self.layers.iter().zip(&sums))
            .map(|(layers, sums)| layers.mean_gradient(&sums[Sum::Mix as usize]))
            .map(|mean| mean.into_iter().map(|slope| (slope / pixels) as f32).collect())
            .collect();
        self.back_from_gate(&offsets, &mut sums, wants);

        if let Some(d_params) = d_params {
            let mut rest = d_params;
            for (layers, (sums, &k)) in self.layers.iter().zip(sums.iter().zip(&self.outputs)) {
                let (gradient, others) = rest.split_at_mut(AdapterParams::len_for(channels, k));
                layers.unfold(sums, gradient);
                rest = others;
            }
        }
        if let Some(d_feature) = d_feature {
            let kept = height * self.shape.row();
            let gradients = &self.feature_gradients;
            d_feature.par_chunks_mut(width).enumerate().for_each(|(index, target)| {
                let (channel, row) = (index / height, index % height);
                target.fill(0.0);
                for adapter in gradients.chunks(kept) {
                    let from = &adapter[row * channels * stride + channel * stride..][..width];
                    target.iter_mut().zip(from).for_each(|(target, value)| *target += value);
                }
            });
        }
        Ok(())
    }

    /// Pass 1 and the channel attention.
    fn gate(&mut self) {
        let Shape { channels, width, height, .. } = self.shape;
        let row = self.shape.row();
        let mut gates = std::mem::take(&mut self.gates);
        let mut tasks: Vec<_> = tasks(&mut gates, height * row, CHUNK * row).collect();
        tasks.sort_by_key(|task| task.1);
        let sums: Vec<(usize, Vec<f64>)> = (tasks.into_par_iter().with_max_len(1))
            .map(|(adapter, chunk, rows)| {
                (adapter, self.pool.with(|scratch| self.gate_chunk(adapter, chunk, rows, scratch)))
            })
            .collect();
        self.gates = gates;
        for (adapter, layers) in self.layers.iter_mut().enumerate() {
            let mut total = vec![0.0; channels];
            for (_, sums) in sums.iter().filter(|(of, _)| *of == adapter) {
                total.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
            }
            layers.attend(total.iter().map(|total| total / (width * height) as f64));
        }
    }

    /// Pass 1 of a chunk: writes the gate's result, returns its sum over the chunk per channel.
    fn gate_chunk(&self, adapter: usize, chunk: usize, rows: &mut [f32], scratch: &mut Scratch) -> Vec<f64> {
        let (shape, layers) = (self.shape, &self.layers[adapter]);
        let Shape { channels: m, stride, .. } = shape;
        let (start, count) = (chunk * CHUNK, rows.len() / shape.row());
        let half = m * stride;
        let places = &self.wide[..m];
        let mut totals = vec![0.0; m * LANES_MAX];
        let mut next = start as isize - 1;
        for first in (0..count).step_by(2) {
            let pair = 2.min(count - first);
            let top = (start + first) as isize;
            while next < top + pair as isize + 1 {
                self.conv1_row(layers, next, &mut scratch.conv1);
                next += 1;
            }
            self.conv2_rows(layers, top, pair, &scratch.conv1, &mut scratch.conv2);
            for (j, target) in rows[first * shape.row()..][..pair * shape.row()].chunks_mut(shape.row()).enumerate() {
                let (left, right) = scratch.conv2[2 * j * half..][..2 * half].split_at(half);
                kernels::product(left, 0.0, right, target);
                shape.clear_tails(target, stride, m);
                kernels::sum(&mut totals, Rows { values: target, offsets: places }, shape.stride);
            }
        }
        totals.chunks(LANES_MAX).map(|lanes| lanes.iter().map(|&lane| f64::from(lane)).sum()).collect()
    }

    /// conv1 of row `row` into its slot; zeros for a row outside the picture.
    fn conv1_row(&self, layers: &Layers, row: isize, ring: &mut Ring) {
        let shape = self.shape;
        let target = ring.row_mut(row);
        if row < 0 || row >= shape.height as isize {
            target.fill(0.0);
            return;
        }
        let source = &self.normal[row as usize * shape.row()..][..shape.row()];
        let source = Rows { values: source, offsets: &self.wide[..shape.channels] };
        kernels::dense(&layers.conv1, source, None, target, shape.padded(), shape.stride);
        shape.clear_tails(target, shape.padded(), 2 * shape.channels);
    }

    /// conv2 of `count` rows (1 or 2) from `top` on, [row][2 channels][column].
    fn conv2_rows(&self, layers: &Layers, top: isize, count: usize, source: &Ring, target: &mut [f32]) {
        let shape = self.shape;
        let rows: [usize; 4] = array::from_fn(|n| source.at(top - 1 + n as isize));
        let source = Window { values: &source.values, rows: &rows[..count + 2], stride: shape.padded() };
        let targets = [0, 2 * shape.row()];
        kernels::depthwise(&layers.conv2, source, target, &targets[..count], shape.stride, shape.stride);
    }

    /// From the gate's result to the result of the block, for one tile: columns from `x` on of row `row`.
    fn middle(&self, adapter: usize, row: usize, x: usize, tile: &mut Tile, out: &mut [f32], stride: usize) {
        let (shape, layers) = (self.shape, &self.layers[adapter]);
        let m = shape.channels;
        let len = TILE.min(shape.stride - x);
        let kept = row * shape.row() + x;
        let gate = &self.gates[adapter * shape.height * shape.row()..][kept..];
        let feature = &self.feature[kept..];
        let (wide, narrow) = (&self.wide[..m], &self.narrow[..m]);
        // The next tile of the row, or the first of the next row.
        let ahead = if x + TILE < shape.stride { TILE } else { shape.row() - x };
        for rows in [gate, feature] {
            if let Some(values) = rows.get(ahead..) {
                kernels::prefetch(Rows { values, offsets: wide }, len);
            }
        }
        let dense =
            |layer: &Dense, source: Rows<'_>, residual: Option<(&[f32], usize)>, target: &mut [f32], stride: usize| {
                kernels::dense(layer, source, residual, target, stride, len);
            };
        dense(&layers.mix, Rows { values: gate, offsets: wide }, Some((feature, shape.stride)), &mut tile.middle, TILE);
        kernels::normalize(m, &tile.middle, &mut tile.normal, TILE, &mut tile.scale, len);
        dense(&layers.conv4, Rows { values: &tile.normal, offsets: narrow }, None, &mut tile.conv4, TILE);
        let (left, right) = tile.conv4.split_at(m * TILE);
        kernels::product(left, 0.0, right, &mut tile.gate);
        dense(&layers.out, Rows { values: &tile.gate, offsets: narrow }, Some((&tile.middle, TILE)), out, stride);
    }

    /// Pass 2 of a chunk, to the rows of each plane.
    fn finish_chunk(&self, adapter: usize, chunk: usize, mut planes: Vec<&mut [f32]>, scratch: &mut Scratch) {
        let (shape, layers) = (self.shape, &self.layers[adapter]);
        let Shape { channels: m, width, height, stride } = shape;
        let start = chunk * CHUNK;
        let count = planes.first().map_or(0, |plane| plane.len() / width);
        let mut next = start as isize - 1;
        for j in 0..count {
            let row = (start + j) as isize;
            while next < row + 2 {
                let target = scratch.out.row_mut(next);
                if next < 0 || next >= height as isize {
                    target.fill(0.0);
                } else {
                    for x in (0..stride).step_by(TILE) {
                        let target = &mut target[x..];
                        self.middle(adapter, next as usize, x, &mut scratch.tile, target, shape.padded());
                    }
                    shape.clear_tails(target, shape.padded(), m);
                }
                next += 1;
            }
            scratch.out.neighbours(row, m, shape.padded(), false, &mut scratch.places);
            let source = Rows { values: &scratch.out.values, offsets: &scratch.places };
            kernels::dense(&layers.end, source, None, &mut scratch.raw, stride, shape.stride);
            for (plane, raw) in planes.iter_mut().zip(scratch.raw.chunks(stride)) {
                plane[j * width..][..width].copy_from_slice(&raw[..width]);
            }
        }
    }

    /// Pass 3: the gradient at the gate but for the attention's part, and the sums of the layers behind it, per adapter.
    fn back_to_gate(&mut self, d_raw: &[f32], wants: Wants) -> Vec<Sums> {
        let row = self.shape.row();
        let kept = self.shape.height * row;
        let mut gradients = std::mem::take(&mut self.gate_gradients);
        let mut features = std::mem::take(&mut self.feature_gradients);
        if wants.feature && features.is_empty() {
            features = Buffer::new(gradients.len());
        }
        let mut feature_rows = features
            .chunks_mut(if wants.feature { kept } else { usize::MAX })
            .flat_map(|adapter| adapter.chunks_mut(CHUNK * row));
        let mut tasks: Vec<_> = (tasks(&mut gradients, kept, CHUNK * row))
            .map(|task| (task, if wants.feature { feature_rows.next() } else { None }))
            .collect();
        tasks.sort_by_key(|task| task.0.1);
        let sums = (tasks.into_par_iter().with_max_len(1))
            .map(|((adapter, chunk, rows), feature)| {
                let work = |scratch: &mut Scratch| {
                    self.back_to_gate_chunk(adapter, chunk, d_raw, rows, feature, wants, scratch);
                    scratch.take_sums()
                };
                (adapter, self.pool.with(work))
            })
            .collect::<Vec<_>>();
        self.gate_gradients = gradients;
        self.feature_gradients = features;
        let mut totals: Vec<Sums> =
            (self.outputs.iter()).map(|&k| sum_lengths(self.shape.channels, k).map(|len| vec![0.0; len])).collect();
        add_up(&mut totals, sums);
        totals
    }

    /// Pass 3 of a chunk.
    #[allow(clippy::too_many_arguments)]
    fn back_to_gate_chunk(
        &self,
        adapter: usize,
        chunk: usize,
        d_raw: &[f32],
        gradients: &mut [f32],
        mut features: Option<&mut [f32]>,
        wants: Wants,
        scratch: &mut Scratch,
    ) {
        let (shape, layers) = (self.shape, &self.layers[adapter]);
        let Shape { channels: m, width, height, stride } = shape;
        let outputs = self.outputs[adapter];
        let planes = &d_raw[self.outputs[..adapter].iter().sum::<usize>() * height * width..];
        let (wide, narrow) = (&self.wide[..m], &self.narrow[..]);
        let Scratch { d_raw: ring, tile, sums, places, .. } = scratch;
        let start = chunk * CHUNK;
        let mut next = start as isize - 1;
        for (j, gradient) in gradients.chunks_mut(shape.row()).enumerate() {
            let row = start + j;
            while next < row as isize + 2 {
                let target = ring.row_mut(next);
                target.fill(0.0);
                if next >= 0 && next < height as isize {
                    for output in 0..outputs {
                        let from = &planes[(output * height + next as usize) * width..][..width];
                        target[output * shape.padded()..][..width].copy_from_slice(from);
                    }
                }
                next += 1;
            }
            ring.neighbours(row as isize, outputs, shape.padded(), true, places);
            let kept = row * shape.row();
            for x in (0..stride).step_by(TILE) {
                let len = TILE.min(stride - x);
                let mut out = std::mem::take(&mut tile.out);
                self.middle(adapter, row, x, tile, &mut out, TILE);
                tile.out = out;
                let used = shape.width.saturating_sub(x).min(len);
                let clear = |rows: &mut [f32]| {
                    if used < len {
                        rows.chunks_mut(TILE).for_each(|row| row[used..len].fill(0.0));
                    }
                };
                clear(&mut tile.out);

                let d_planes = Rows { values: &ring.values[x..], offsets: places };
                kernels::dense(&layers.end_transposed, d_planes, None, &mut tile.d_out, TILE, len);
                clear(&mut tile.d_out);
                let d_out = Rows { values: &tile.d_out, offsets: &narrow[..m] };
                kernels::dense(&layers.out_transposed, d_out, None, &mut tile.d_gate, TILE, len);
                let (left, right) = tile.conv4.split_at(m * TILE);
                let (d_left, d_right) = tile.d_conv4.split_at_mut(m * TILE);
                kernels::product(&tile.d_gate, 0.0, right, d_left);
                kernels::product(&tile.d_gate, 0.0, left, d_right);
                let d_conv4 = Rows { values: &tile.d_conv4, offsets: narrow };
                kernels::dense(&layers.conv4_transposed, d_conv4, None, &mut tile.d_normal, TILE, len);

                let tile_rows = |values| Rows { values, offsets: &narrow[..m] };
                if wants.params {
                    let mut outer = |sum: Sum, left, right| kernels::outer(&mut sums[sum as usize], left, right, len);
                    outer(Sum::End, d_planes, tile_rows(&tile.out));
                    outer(Sum::Out, d_out, tile_rows(&tile.gate));
                    outer(Sum::Conv4, d_conv4, tile_rows(&tile.normal));
                }
                // From here on `d_out` is the gradient of `middle`.
                let d_out = &mut tile.d_out;
                kernels::normalize_backward(m, &tile.d_normal, &tile.normal, &tile.scale, d_out, TILE, len);
                let d_middle = tile_rows(&tile.d_out);
                let gate = &self.gates[adapter * height * shape.row()..][kept + x..];
                kernels::outer(&mut sums[Sum::Mix as usize], d_middle, Rows { values: gate, offsets: wide }, len);
                kernels::dense(&layers.mix_transposed, d_middle, None, &mut gradient[x..], stride, len);
                if let Some(features) = &mut features {
                    for channel in 0..m {
                        features[j * shape.row() + channel * stride + x..][..len]
                            .copy_from_slice(&tile.d_out[channel * TILE..][..len]);
                    }
                }
            }
        }
    }

    /// Pass 4: the sums of conv1 and conv2, and the rest of the feature's gradient. `offsets` is what the attention adds at the gate.
    fn back_from_gate(&mut self, offsets: &[Vec<f32>], totals: &mut [Sums], wants: Wants) {
        let (height, row) = (self.shape.height, self.shape.row());
        let mut features = std::mem::take(&mut self.feature_gradients);
        let chunks = height.div_ceil(CHUNK);
        let mut feature_rows = features
            .chunks_mut(if wants.feature { height * row } else { usize::MAX })
            .flat_map(|adapter| adapter.chunks_mut(CHUNK * row));
        let mut tasks: Vec<_> = (0..self.outputs.len() * chunks)
            .map(|task| (task / chunks, task % chunks, if wants.feature { feature_rows.next() } else { None }))
            .collect();
        tasks.sort_by_key(|task| Reverse(task.1));
        let sums = (tasks.into_par_iter().with_max_len(1))
            .map(|(adapter, chunk, feature)| {
                let work = |scratch: &mut Scratch| {
                    self.back_from_gate_chunk(adapter, chunk, &offsets[adapter], feature, wants, scratch);
                    scratch.take_sums()
                };
                (adapter, self.pool.with(work))
            })
            .collect::<Vec<_>>();
        self.feature_gradients = features;
        add_up(totals, sums);
    }

    /// Pass 4 of a chunk.
    fn back_from_gate_chunk(
        &self,
        adapter: usize,
        chunk: usize,
        offsets: &[f32],
        mut features: Option<&mut [f32]>,
        wants: Wants,
        scratch: &mut Scratch,
    ) {
        let shape = self.shape;
        let layers = &self.layers[adapter];
        let start = (chunk * CHUNK) as isize;
        let end = ((chunk + 1) * CHUNK).min(shape.height) as isize;
        let mut next = start - 2;
        let mut done = start;
        // The row before the chunk alone, so that its own rows come in pairs, and the row behind it.
        let mut first = start - 1;
        while first <= end {
            let pair = if first < start || first + 1 >= end { 1 } else { 2 };
            while next < first + pair + 1 {
                self.conv1_row(layers, next, &mut scratch.conv1);
                next += 1;
            }
            self.d_conv2_rows(adapter, first, pair as usize, offsets, scratch);
            if wants.params && first >= start && first < end {
                self.conv2_sums(first, pair as usize, scratch);
            }
            first += pair;
            // A row needs the gradients of the row below it.
            while done < end && done + 1 < first {
                let rows = (first - 1 - done).min(end - done).min(2);
                let features = features.as_deref_mut().map(|f| &mut f[(done - start) as usize * shape.row()..]);
                self.d_conv1_rows(layers, done, rows as usize, features, wants, scratch);
                done += rows;
            }
        }
    }

    /// The gradient of conv2's result in one or two rows; zeros outside the picture.
    fn d_conv2_rows(&self, adapter: usize, top: isize, count: usize, offsets: &[f32], scratch: &mut Scratch) {
        let shape = self.shape;
        let Shape { channels: m, stride, .. } = shape;
        let inside = top >= 0 && top < shape.height as isize;
        if inside {
            self.conv2_rows(&self.layers[adapter], top, count, &scratch.conv1, &mut scratch.conv2);
        }
        for j in 0..count {
            let target = scratch.d_conv2.row_mut(top + j as isize);
            if !inside {
                target.fill(0.0);
                continue;
            }
            let gradient = &self.gate_gradients[adapter * shape.height * shape.row()..];
            let gradient = &gradient[(top as usize + j) * shape.row()..][..shape.row()];
            let (left, right) = scratch.conv2[2 * j * shape.row()..][..2 * shape.row()].split_at(shape.row());
            for (channel, &offset) in offsets.iter().enumerate() {
                let of = channel * stride..(channel + 1) * stride;
                let gradient = &gradient[of.clone()];
                let at = channel * shape.padded();
                kernels::product(gradient, offset, &right[of.clone()], &mut target[at..at + stride]);
                let at = (m + channel) * shape.padded();
                kernels::product(gradient, offset, &left[of], &mut target[at..at + stride]);
            }
            shape.clear_tails(target, shape.padded(), 2 * m);
        }
    }

    /// Adds one or two rows to the gradients of conv2.
    fn conv2_sums(&self, top: isize, count: usize, scratch: &mut Scratch) {
        let shape = self.shape;
        let channels = 2 * shape.channels;
        let Scratch { conv1, d_conv2, sums, .. } = scratch;
        let rows: [usize; 2] = array::from_fn(|j| d_conv2.at(top + j as isize));
        let sources: [usize; 4] = array::from_fn(|n| conv1.at(top - 1 + n as isize));
        let gradient = Window { values: &d_conv2.values, rows: &rows[..count], stride: shape.padded() };
        let source = Window { values: &conv1.values, rows: &sources[..count + 2], stride: shape.padded() };
        kernels::depthwise_weights(&mut sums[Sum::Conv2 as usize], gradient, source, channels, shape.stride);
    }

    /// The gradient of conv1's result in one or two rows, added to the gradients of conv1 and taken on to the feature.
    fn d_conv1_rows(
        &self,
        layers: &Layers,
        top: isize,
        count: usize,
        mut features: Option<&mut [f32]>,
        wants: Wants,
        scratch: &mut Scratch,
    ) {
        let shape = self.shape;
        let Shape { channels: m, stride, .. } = shape;
        let Scratch { d_conv2, d_conv1, d_normal, sums, .. } = scratch;
        let rows: [usize; 4] = array::from_fn(|n| d_conv2.at(top - 1 + n as isize));
        let source = Window { values: &d_conv2.values, rows: &rows[..count + 2], stride: shape.padded() };
        let targets = [0, 2 * shape.row()];
        let taps = &layers.conv2_transposed;
        kernels::depthwise(taps, source, d_conv1, &targets[..count], stride, shape.stride);
        let places = &self.wide[..];
        for (j, gradient) in d_conv1.chunks_mut(2 * shape.row()).take(count).enumerate() {
            shape.clear_tails(gradient, stride, 2 * m);
            let row = top as usize + j;
            let normal = &self.normal[row * shape.row()..][..shape.row()];
            let gradient = Rows { values: gradient, offsets: places };
            if wants.params {
                let normal = Rows { values: normal, offsets: &places[..m] };
                kernels::outer(&mut sums[Sum::Conv1 as usize], gradient, normal, shape.stride);
            }
            if let Some(features) = &mut features {
                kernels::dense(&layers.conv1_transposed, gradient, None, d_normal, stride, shape.stride);
                let scale = &self.scale[row * stride..][..stride];
                let target = &mut features[j * shape.row()..][..shape.row()];
                kernels::normalize_backward(m, d_normal, normal, scale, target, stride, stride);
            }
        }
    }
}

/// Which gradients are asked for.
#[derive(Clone, Copy)]
struct Wants {
    params: bool,
    feature: bool,
}

/// Chunks of all adapters in order: adapter, chunk, its rows.
fn tasks(values: &mut [f32], adapter: usize, chunk: usize) -> impl Iterator<Item = (usize, usize, &mut [f32])> {
    values.chunks_mut(adapter).enumerate().flat_map(move |(adapter, values)| {
        values.chunks_mut(chunk).enumerate().map(move |(chunk, rows)| (adapter, chunk, rows))
    })
}

/// From the chunks of each plane to the planes of each chunk.
fn transpose<'a>(planes: impl Iterator<Item = std::slice::ChunksMut<'a, f32>>) -> Vec<Vec<&'a mut [f32]>> {
    let mut chunks = Vec::new();
    for plane in planes {
        for (chunk, rows) in plane.enumerate() {
            if chunks.len() == chunk {
                chunks.push(Vec::new());
            }
            chunks[chunk].push(rows);
        }
    }
    chunks
}

/// Adds the sums of all chunks, in order, to those of their adapters.
fn add_up(totals: &mut [Sums], sums: Vec<(usize, Sums)>) {
    for (adapter, sums) in sums {
        for (total, sum) in totals[adapter].iter_mut().zip(sums) {
            total.iter_mut().zip(sum).for_each(|(total, sum)| *total += sum);
        }
    }
}

fn check_len(name: &str, expected: usize, got: usize) -> Result<()> {
    if expected == got {
        Ok(())
    } else {
        Err(Error::shape(name, format!("{expected} values"), format!("{got} values")))
    }
}

#[cfg(test)]
mod tests {
    use super::Adapters;
    use crate::nn::AdapterParams;
    use crate::real::SINGLE;

    #[test]
    fn single_numbers_give_what_lanes_give() {
        let (width, height, outputs) = (150, 37, [2, 3]);
        let noise = |len: usize| -> Vec<f32> {
            (0..len).map(|i| ((i as f64 * 0.618_033_988_75 + 0.3).fract() - 0.5) as f32).collect()
        };
        let single = rayon::ThreadPoolBuilder::new().num_threads(2).start_handler(|_| SINGLE.set(true));
        let single = single.build().unwrap();
        for channels in [9, 14] {
            let feature = noise(channels * width * height);
            let params = noise(outputs.iter().map(|&k| AdapterParams::len_for(channels, k)).sum());
            let run = || {
                let mut adapters = Adapters::new(&feature, channels, &outputs, width, height).unwrap();
                let mut raw = vec![0.0; adapters.raw_len()];
                let (mut d_params, mut d_feature) = (vec![0.0; params.len()], vec![0.0; feature.len()]);
                adapters.forward(&params, &mut raw).unwrap();
                adapters.backward(&raw, Some(&mut d_params), Some(&mut d_feature)).unwrap();
                [raw, d_params, d_feature]
            };
            for (plain, vectors) in single.install(run).iter().zip(&run()) {
                let scale = plain.iter().fold(0.0f32, |scale, x| scale.max(x.abs()));
                assert!(plain.iter().zip(vectors).all(|(a, b)| (a - b).abs() <= 1e-5 * scale), "{scale}");
            }
        }
    }
}
