//! The graph convolution that fuses the photos' features.

use dfdx::tensor::{Cpu, Tape};
use rayon::prelude::*;

use super::attention::affine;
use super::{conv3x3, expect};
use crate::error::{Error, Result};
use crate::nn::kernels::{add, dot, sum};
use crate::nn::layout::Layout;
use crate::nn::matrix::{Matrix, multiply};
use crate::nn::nafnet::Layer;
use crate::nn::scalar::Scalar;
use crate::nn::tape::{Buffer, Param, Planes, Pool, record};

/// The parameters of the graph convolution on C channels, the nodes of the graph.
#[derive(Clone)]
pub(crate) struct Graph<E: Scalar> {
    /// Queries, a 3x3 convolution C -> C.
    pub query: Layer<E>,
    /// Keys, likewise.
    pub key: Layer<E>,
    /// What travels along the edges, likewise.
    pub feature: Layer<E>,
    /// Fixed part of the adjacency matrix, (C, C).
    pub adjacency: Param<E>,
    /// Factor on the sum over neighbours, one value.
    pub lambda: Param<E>,
    /// Only the edges from each node to itself, as in the released weights.
    pub diagonal: bool,
}

/// `relu(lambda sum_i h_i A_ij)` with `h` a 3x3 convolution of `x` and `A_ij = adjacency_ij + tanh(q_i - k_j)`, where `q` and `k` are means
/// over pixels of 3x3 convolutions of `x`; with [`Graph::diagonal`] the sum has the term i = j alone. (C, H, W) -> (C, H, W).
///
/// # Source
/// Luo et al. 2024, eq. 2.
pub(crate) fn graph_convolution<E: Scalar, T: Tape<E, Cpu>>(x: Planes<E, T>, graph: &Graph<E>) -> Result<Planes<E, T>> {
    let (layout, c) = (x.layout, x.layout.channels);
    expect("adjacency", &graph.adjacency, c * c)?;
    expect("lambda", &graph.lambda, 1)?;
    for layer in [&graph.query, &graph.key] {
        expect("query and key weight", &layer.weight, 9 * c * c)?;
        expect("query and key bias", &layer.bias, c)?;
    }
    let feature = conv3x3(x.branch(), 1, &graph.feature.weight, &graph.feature.bias)?;
    if feature.layout != layout {
        return Err(Error::shape("graph feature", format!("{c} channels"), feature.layout.channels.to_string()));
    }

    let means = neighbourhood_means(x.values(), layout);
    let query = affine(graph.query.weight.values(), &means, graph.query.bias.values());
    let key = affine(graph.key.weight.values(), &means, graph.key.bias.values());
    let edges: Vec<E> = (0..c * c).map(|e| (query[e / c] - key[e % c]).tanh()).collect();
    let adjacency: Vec<E> = graph.adjacency.values().iter().zip(&edges).map(|(&fixed, &edge)| fixed + edge).collect();
    let lambda = graph.lambda.values()[0];
    let mut out = along_edges(x.pool(), feature.values(), layout, &adjacency, graph.diagonal);
    out.par_iter_mut().for_each(|value| *value = rectified(lambda * *value));

    let ((x, tape), (feature, other)) = (x.split(), feature.split());
    let graph = graph.clone();
    let coupled = [&graph.query, &graph.key].iter().any(|layer| layer.weight.is_tracked() || layer.bias.is_tracked());
    let tracked = coupled || graph.adjacency.is_tracked() || graph.lambda.is_tracked();
    let wanted = T::OWNS_TAPE && (x.is_wanted() || feature.is_wanted() || tracked);
    record(out, layout, tape.merge(other), wanted, move |mut dy, grads| {
        let sums = along_edges(x.pool(), feature.values(), layout, &adjacency, graph.diagonal);
        for (dy, &sum) in dy.iter_mut().zip(sums.iter()) {
            if lambda * sum <= E::default() {
                *dy = E::default();
            }
        }
        graph.lambda.add_gradient(grads, |dlambda| dlambda[0] += dot(&dy, &sums))?;
        drop(sums);
        dy.iter_mut().for_each(|dy| *dy *= lambda);

        let dadjacency = edge_gradients(feature.values(), &dy, layout, graph.diagonal);
        graph.adjacency.add_gradient(grads, |gradient| add(gradient, &dadjacency))?;
        let (mut dquery, mut dkey) = (vec![E::default(); c], vec![E::default(); c]);
        for (e, (&gradient, &edge)) in dadjacency.iter().zip(&edges).enumerate() {
            let slope = gradient * (E::ONE - edge * edge);
            dquery[e / c] += slope;
            dkey[e % c] -= slope;
        }
        let mut dmeans = vec![E::default(); 9 * c];
        for (layer, gradient) in [(&graph.query, &dquery), (&graph.key, &dkey)] {
            let gradient_column = Matrix::new(gradient, c, 1);
            layer.bias.add_gradient(grads, |dbias| add(dbias, gradient))?;
            layer.weight.add_gradient(grads, |dweight| {
                multiply(dweight, true, gradient_column, Matrix::new(&means, 1, 9 * c));
            })?;
            multiply(&mut dmeans, true, Matrix::new(layer.weight.values(), c, 9 * c).transposed(), gradient_column);
        }
        feature.add_gradient(grads, || {
            let mut dfeature = feature.pool().take(layout.len());
            dfeature.par_chunks_mut(layout.band_len()).zip(dy.par_chunks(layout.band_len())).for_each(|(out, dy)| {
                if graph.diagonal {
                    for (j, (out, dy)) in rows(out, c).zip(dy.chunks_exact(dy.len() / c)).enumerate() {
                        out.iter_mut().zip(dy).for_each(|(out, &dy)| *out = dy * adjacency[j * c + j]);
                    }
                } else {
                    multiply(out, false, Matrix::new(&adjacency, c, c), Matrix::new(dy, c, dy.len() / c));
                }
            });
            dfeature
        })?;
        x.add_gradient(grads, || {
            let mut dx = x.pool().zeros(layout.len());
            add_means_gradient(&mut dx, layout, &dmeans);
            dx
        })
    })
}

fn rectified<E: Scalar>(value: E) -> E {
    if value > E::default() { value } else { E::default() }
}

/// The channels of a band.
fn rows<E>(band: &mut [E], channels: usize) -> std::slice::ChunksExactMut<'_, E> {
    let pixels = band.len() / channels;
    band.chunks_exact_mut(pixels)
}

/// `sum_i h_i A_ij` for every channel j.
fn along_edges<E: Scalar>(pool: &Pool<E>, feature: &[E], layout: Layout, adjacency: &[E], diagonal: bool) -> Buffer<E> {
    let c = layout.channels;
    let mut out = pool.take(feature.len());
    out.par_chunks_mut(layout.band_len()).zip(feature.par_chunks(layout.band_len())).for_each(|(out, feature)| {
        if diagonal {
            for (j, (out, feature)) in rows(out, c).zip(feature.chunks_exact(feature.len() / c)).enumerate() {
                out.iter_mut().zip(feature).for_each(|(out, &feature)| *out = feature * adjacency[j * c + j]);
            }
        } else {
            let adjacency = Matrix::new(adjacency, c, c).transposed();
            multiply(out, false, adjacency, Matrix::new(feature, c, feature.len() / c));
        }
    });
    out
}

/// The gradient with respect to the adjacency matrix.
fn edge_gradients<E: Scalar>(feature: &[E], dy: &[E], layout: Layout, diagonal: bool) -> Vec<E> {
    let c = layout.channels;
    let mut out = vec![E::default(); c * c];
    for (feature, dy) in feature.chunks(layout.band_len()).zip(dy.chunks(layout.band_len())) {
        let pixels = dy.len() / c;
        if diagonal {
            for (j, (feature, dy)) in feature.chunks_exact(pixels).zip(dy.chunks_exact(pixels)).enumerate() {
                out[j * c + j] += dot(feature, dy);
            }
        } else {
            let dy = Matrix::new(dy, c, pixels).transposed();
            multiply(&mut out, true, Matrix::new(feature, c, pixels), dy);
        }
    }
    out
}

/// For every channel and tap of a 3x3 convolution with zero padding the mean over pixels of what the tap sees, (C * 9): the mean of the
/// convolution is its weights times these.
fn neighbourhood_means<E: Scalar>(x: &[E], layout: Layout) -> Vec<E> {
    let share = 1.0 / layout.pixels() as f64;
    let of_channel = |channel: usize| -> [f64; 9] {
        let mut sums = [0.0; 9];
        for row in 0..layout.height {
            let line = &x[layout.row(channel, row)];
            let all = sum(line).wide();
            let seen = [all - line[layout.width - 1].wide(), all, all - line[0].wide()];
            for (tap, total) in sums.iter_mut().enumerate() {
                if tap_sees_row(tap, row, layout) {
                    *total += seen[tap % 3];
                }
            }
        }
        sums
    };
    (0..layout.channels).into_par_iter().flat_map_iter(|c| of_channel(c).map(|sum| E::splat(sum * share))).collect()
}

/// Whether a tap's row offset keeps `row` in sight of some output pixel.
fn tap_sees_row(tap: usize, row: usize, layout: Layout) -> bool {
    match tap / 3 {
        0 => row + 1 < layout.height,
        1 => true,
        _ => row > 0,
    }
}

/// Adds the gradient that comes through [`neighbourhood_means`].
fn add_means_gradient<E: Scalar>(dx: &mut [E], layout: Layout, dmeans: &[E]) {
    let share = E::splat(1.0 / layout.pixels() as f64);
    for channel in 0..layout.channels {
        for row in 0..layout.height {
            let mut slopes = [E::default(); 3];
            for tap in (0..9).filter(|&tap| tap_sees_row(tap, row, layout)) {
                slopes[tap % 3] += dmeans[9 * channel + tap] * share;
            }
            let all = slopes[0] + slopes[1] + slopes[2];
            let line = &mut dx[layout.row(channel, row)];
            line.iter_mut().for_each(|dx| *dx += all);
            line[layout.width - 1] -= slopes[0];
            line[0] -= slopes[2];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Graph, graph_convolution};
    use crate::nn::layout::Layout;
    use crate::nn::nafnet::Layer;
    use crate::nn::ops::conv3x3;
    use crate::nn::ops::testing::{check, compare, numbers};
    use crate::nn::tape::{Param, Planes};

    fn graph(params: &[Param<f64>], diagonal: bool) -> Graph<f64> {
        let layer = |i: usize| Layer { weight: params[i].clone(), bias: params[i + 1].clone() };
        let (adjacency, lambda) = (params[6].clone(), params[7].clone());
        Graph { query: layer(0), key: layer(2), feature: layer(4), adjacency, lambda, diagonal }
    }

    fn sizes(c: usize) -> [usize; 8] {
        [9 * c * c, c, 9 * c * c, c, 9 * c * c, c, c * c, 1]
    }

    #[test]
    fn values_are_those_of_the_definition() {
        let layout = Layout { channels: 3, height: 20, width: 40 };
        let params: Vec<Param<f64>> =
            sizes(3).iter().enumerate().map(|(i, &len)| Param::constant(numbers(len, i as u64).into())).collect();
        let x = Planes::constant(numbers(layout.len(), 50), layout).unwrap();
        let planar = |i: usize| {
            let out = conv3x3(x.branch(), 1, &params[i], &params[i + 1]).unwrap();
            layout.unpack(out.values(), 20, 40)
        };
        let mean =
            |values: Vec<f64>| -> Vec<f64> { values.chunks(800).map(|v| v.iter().sum::<f64>() / 800.0).collect() };
        let (query, key, feature) = (mean(planar(0)), mean(planar(2)), planar(4));
        for diagonal in [false, true] {
            let mut expected = vec![0.0; 2400];
            for j in 0..3 {
                for i in (0..3).filter(|&i| !diagonal || i == j) {
                    let edge = params[6].values()[i * 3 + j] + (query[i] - key[j]).tanh();
                    for p in 0..800 {
                        expected[j * 800 + p] += feature[i * 800 + p] * edge;
                    }
                }
            }
            let expected: Vec<f64> = expected.iter().map(|v| (v * params[7].values()[0]).max(0.0)).collect();
            let out = graph_convolution(x.branch(), &graph(&params, diagonal)).unwrap();
            compare(&layout.unpack(out.values(), 20, 40), &expected, 1e-13, "graph convolution");
        }
    }

    #[test]
    fn gradients() {
        for (height, width) in [(20, 40), (1, 4), (3, 1)] {
            for diagonal in [false, true] {
                let layout = Layout { channels: 3, height, width };
                check(layout, &sizes(3), |x, params| graph_convolution(x, &graph(params, diagonal)));
            }
        }
    }
}
