//! Encoder and decoder, put together from the tape's operations.

use std::sync::Arc;

use dfdx::tensor::{Cpu, Tape};

use super::config::{Gcn, NetworkConfig};
use super::nafnet::{Block, Layer, block};
use super::ops::{Graph, conv3x3, graph_convolution, pixel_shuffle, pixel_unshuffle, pointwise};
use super::scalar::Scalar;
use super::tape::{End, Loss, Param, Planes, Pullback, Recording, Slot};
use crate::error::Result;
use crate::progress::Control;

/// What gives a network's parameters by name.
pub(crate) type Source<'a, E> = dyn FnMut(&str) -> Result<Param<E>> + 'a;

/// Weight and bias of layer `name`.
pub(crate) fn layer<E: Scalar>(get: &mut Source<'_, E>, name: &str) -> Result<Layer<E>> {
    Ok(Layer { weight: get(&format!("{name}.weight"))?, bias: get(&format!("{name}.bias"))? })
}

/// Blocks that run one after the other.
pub(crate) type Blocks<E> = Vec<Arc<Block<E>>>;

/// The `count` blocks `name.0`, `name.1`, ...
pub(crate) fn blocks<E: Scalar>(
    get: &mut Source<'_, E>,
    name: &str,
    count: usize,
    channels: usize,
) -> Result<Blocks<E>> {
    let one = |index| Ok(Arc::new(Block::new(channels, |tensor| get(&format!("{name}.{index}.{tensor}")))?));
    (0..count).map(one).collect()
}

/// The first layers of the encoder.
enum Intro<E: Scalar> {
    Plain(Layer<E>),
    Graph { conv0: Layer<E>, graph: Box<Graph<E>> },
}

/// A level of the encoder: its blocks, then the way down.
struct Descent<E: Scalar> {
    blocks: Blocks<E>,
    down: Layer<E>,
}

/// A level of the decoder: the way up, then its blocks.
struct Ascent<E: Scalar> {
    up: Param<E>,
    blocks: Blocks<E>,
}

/// What the encoder makes of photos.
pub(crate) struct Encoded<E: Scalar, T> {
    pub latent: Planes<E, T>,
    /// Finest first.
    pub skips: Vec<Planes<E, T>>,
}

/// Photos to latent code and skips.
pub(crate) struct Encoder<E: Scalar> {
    photos: usize,
    intro: Intro<E>,
    levels: Vec<Descent<E>>,
}

impl<E: Scalar> Encoder<E> {
    /// The encoder of a network.
    pub fn new(config: &NetworkConfig, get: &mut Source<'_, E>) -> Result<Self> {
        let intro = match config.gcn {
            Gcn::None => Intro::Plain(layer(get, "encoder.intro")?),
            form => Intro::Graph {
                conv0: layer(get, "encoder.conv0")?,
                graph: Box::new(Graph {
                    query: layer(get, "encoder.conv_q1")?,
                    key: layer(get, "encoder.conv_k1")?,
                    feature: layer(get, "encoder.conv1")?,
                    adjacency: get("encoder.adj1")?,
                    lambda: get("encoder.lamda")?,
                    diagonal: form == Gcn::Diagonal,
                }),
            },
        };
        let level = |(level, &count): (usize, &usize)| {
            let blocks = blocks(get, &format!("encoder.encoders.{level}"), count, config.channels(level))?;
            Ok(Descent { blocks, down: layer(get, &format!("encoder.downs.{level}"))? })
        };
        let levels = config.encoder_blocks.iter().enumerate().map(level).collect::<Result<_>>()?;
        Ok(Self { photos: config.photos, intro, levels })
    }

    /// Encodes photos whose channels lie one photo after the other.
    pub fn run<T: Tape<E, Cpu>>(&self, photos: Planes<E, T>, control: &mut Control<'_>) -> Result<Encoded<E, T>> {
        let mut x = match &self.intro {
            Intro::Plain(intro) => conv3x3(photos, 1, &intro.weight, &intro.bias)?,
            Intro::Graph { conv0, graph } => {
                let features = conv3x3(photos, self.photos, &conv0.weight, &conv0.bias)?;
                control.poll()?;
                graph_convolution(features, graph)?
            }
        };
        let mut skips = Vec::with_capacity(self.levels.len());
        for Descent { blocks, down } in &self.levels {
            for one in blocks {
                control.poll()?;
                x = block(x, one)?;
            }
            skips.push(x.branch());
            x = pointwise(pixel_unshuffle(x)?, &down.weight, Some(&down.bias))?;
        }
        Ok(Encoded { latent: x, skips })
    }
}

/// Latent code and skips to material feature.
pub(crate) struct Decoder<E: Scalar> {
    middle: Vec<Arc<Block<E>>>,
    levels: Vec<Ascent<E>>,
    ending: Layer<E>,
}

/// A part of the decoder after which a run can be stopped.
enum Part<'a, E: Scalar> {
    Block(&'a Arc<Block<E>>),
    /// Into the level whose skip has this index.
    Up(&'a Param<E>, usize),
    Ending(&'a Layer<E>),
}

impl<E: Scalar> Part<'_, E> {
    fn run<T: Tape<E, Cpu>>(&self, x: Planes<E, T>, skips: &[Planes<E>]) -> Result<Planes<E, T>> {
        match self {
            Self::Block(one) => block(x, one),
            Self::Up(weight, level) => {
                pixel_shuffle(pointwise(x, weight, None)?, Some(skips[*level].branch().put(T::default())))
            }
            Self::Ending(ending) => conv3x3(x, 1, &ending.weight, &ending.bias),
        }
    }
}

impl<E: Scalar> Decoder<E> {
    /// The decoder of a network.
    pub fn new(config: &NetworkConfig, get: &mut Source<'_, E>) -> Result<Self> {
        let middle = blocks(get, "decoder.middle_blks", config.middle_blocks, config.latent_channels())?;
        let level = |(step, &count): (usize, &usize)| {
            let up = get(&format!("decoder.ups.{step}.0.weight"))?;
            let channels = config.channels(config.levels() - 1 - step);
            Ok(Ascent { up, blocks: blocks(get, &format!("decoder.decoders.{step}"), count, channels)? })
        };
        let levels = config.decoder_blocks.iter().enumerate().map(level).collect::<Result<_>>()?;
        Ok(Self { middle, levels, ending: layer(get, "decoder.ending")? })
    }

    fn parts(&self) -> impl Iterator<Item = Part<'_, E>> {
        let levels = self.levels.iter().enumerate().flat_map(|(step, Ascent { up, blocks })| {
            std::iter::once(Part::Up(up, self.levels.len() - 1 - step)).chain(blocks.iter().map(Part::Block))
        });
        self.middle.iter().map(Part::Block).chain(levels).chain([Part::Ending(&self.ending)])
    }

    /// The material feature.
    pub fn run(&self, latent: Planes<E>, skips: &[Planes<E>], control: &mut Control<'_>) -> Result<Planes<E>> {
        let mut x = latent;
        for part in self.parts() {
            control.poll()?;
            x = part.run(x, skips)?;
        }
        Ok(x)
    }

    /// The material feature, and what is needed to take a gradient back to the latent code.
    pub fn run_traced(&self, latent: Planes<E>, skips: &[Planes<E>], control: &mut Control<'_>) -> Result<Trace<E>> {
        let mut trace = Trace { input: latent.slot(), feature: latent.traced(), parts: Vec::new() };
        for part in self.parts() {
            control.poll()?;
            let (input, end) = trace.feature.cut();
            trace.parts.push(Taped { input: std::mem::replace(&mut trace.input, input.slot()), end });
            trace.feature = part.run(input.traced(), skips)?;
        }
        Ok(trace)
    }
}

/// A run of the decoder whose gradient can be taken: one tape for each part, so that the way back can be stopped between parts and
/// memory is freed as it goes.
pub(crate) struct Trace<E: Scalar> {
    /// The material feature, on the tape of the last part.
    pub feature: Planes<E, Recording<E>>,
    /// The input of the last part.
    input: Slot<E>,
    /// The parts before it.
    parts: Vec<Taped<E>>,
}

/// Where the gradient of a part's input goes, and the end of the part's tape.
struct Taped<E: Scalar> {
    input: Slot<E>,
    end: End<E>,
}

impl<E: Scalar> Trace<E> {
    /// The gradient with respect to the latent code, given that with respect to the material feature.
    pub fn pull_back(self, gradient: Vec<E>, control: &mut Control<'_>) -> Result<Vec<E>> {
        let Self { feature, input, parts } = self;
        let (_, end) = feature.cut();
        through(parts, end.pull_back(gradient)?.of(&input)?, control)
    }

    /// What `loss` computes from the material feature on the tape of the decoder's last part, and its gradient with respect to the latent code.
    pub fn descend(
        self,
        loss: impl FnOnce(Planes<E, Recording<E>>) -> Result<Loss<E>>,
        control: &mut Control<'_>,
    ) -> Result<(E, Vec<E>)> {
        let Self { feature, input, parts } = self;
        let loss = loss(feature)?;
        control.poll()?;
        let value = loss.as_vec()[0];
        let gradient = Pullback::from(loss)?.of(&input)?;
        Ok((value, through(parts, gradient, control)?))
    }
}

/// Takes `gradient` back through `parts`, the last one first.
fn through<E: Scalar>(parts: Vec<Taped<E>>, mut gradient: Vec<E>, control: &mut Control<'_>) -> Result<Vec<E>> {
    for Taped { input, end } in parts.into_iter().rev() {
        control.poll()?;
        gradient = end.pull_back(gradient)?.of(&input)?;
    }
    Ok(gradient)
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::{Decoder, Encoder};
    use crate::maps::Lobe;
    use crate::nn::config::{Gcn, NetworkConfig};
    use crate::nn::kernels::dot;
    use crate::nn::layout::Layout;
    use crate::nn::ops::testing::{check, compare, numbers};
    use crate::nn::tape::{Param, Planes};
    use crate::progress::{CancelToken, Control, Progress};

    fn small(photos: usize, gcn: Gcn) -> NetworkConfig {
        NetworkConfig {
            photos,
            width: 4,
            encoder_blocks: vec![1, 2],
            middle_blocks: 1,
            decoder_blocks: vec![1, 1],
            gcn,
            lobe: Lobe::Isotropic,
            roughness_floor: -1.0,
        }
    }

    /// All parameters of `config`'s network as one list, and a source that gives them by name.
    fn source(config: &NetworkConfig, params: &[Param<f64>]) -> impl FnMut(&str) -> crate::Result<Param<f64>> {
        let (tensors, params) = (config.tensors(), params.to_vec());
        move |name| Ok(params[tensors.iter().position(|tensor| tensor.0 == name).unwrap()].clone())
    }

    fn sizes(config: &NetworkConfig) -> Vec<usize> {
        config.tensors().iter().map(|(_, shape)| shape.iter().product()).collect()
    }

    fn constants(config: &NetworkConfig) -> Vec<Param<f64>> {
        let sizes = sizes(config).into_iter().enumerate();
        sizes
            .map(|(i, len)| Param::constant(numbers(len, i as u64).iter().map(|v| 0.5 * v).collect::<Vec<_>>().into()))
            .collect()
    }

    #[test]
    fn decoder_gradient() {
        let config = small(4, Gcn::Full);
        let decoder = Decoder::new(&config, &mut source(&config, &constants(&config))).unwrap();
        let layout = |channels, scale: usize| Layout { channels, height: 5 * scale, width: 6 * scale };
        let plane = |layout: Layout, seed| Planes::constant(numbers(layout.len(), seed), layout).unwrap();
        let skips = [plane(layout(4, 4), 1), plane(layout(8, 2), 2)];
        let latent = numbers(layout(16, 1).len(), 3);
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        let mut control = Control::new(&mut callback, CancelToken::new());
        let mut run = |latent: &[f64]| {
            decoder
                .run(Planes::constant(latent.to_vec(), layout(16, 1)).unwrap(), &skips, &mut control)
                .unwrap()
                .values()
                .to_vec()
        };
        let values = run(&latent);
        let seed = numbers(values.len(), 9);
        let mut loss = |latent: &[f64]| dot(&run(latent), &seed);
        let mut expected = vec![0.0; latent.len()];
        for (i, expected) in expected.iter_mut().enumerate() {
            let mut difference = |step: f64| {
                let mut moved = latent.clone();
                moved[i] += step;
                let up = loss(&moved);
                moved[i] = latent[i] - step;
                (up - loss(&moved)) / (2.0 * step)
            };
            *expected = (4.0 * difference(1e-4) - difference(2e-4)) / 3.0;
        }
        let mut callback = |_: &Progress| ControlFlow::Continue(());
        let mut control = Control::new(&mut callback, CancelToken::new());
        let planes = Planes::constant(latent, layout(16, 1)).unwrap();
        let trace = decoder.run_traced(planes, &skips, &mut control).unwrap();
        compare(trace.feature.values(), &values, 1e-12, "feature");
        compare(&trace.pull_back(seed, &mut control).unwrap(), &expected, 1e-7, "gradient");
    }

    #[test]
    fn encoder_gradients() {
        for (photos, gcn) in [(1, Gcn::None), (2, Gcn::None), (2, Gcn::Full), (2, Gcn::Diagonal)] {
            let config = small(photos, gcn);
            let layout = Layout { channels: 3 * photos, height: 12, width: 8 };
            let encoder_tensors = config.tensors().iter().filter(|tensor| tensor.0.starts_with("encoder.")).count();
            check(layout, &sizes(&config)[..encoder_tensors], |x, params| {
                let encoder = Encoder::new(&config, &mut source(&config, params))?;
                let mut callback = |_: &Progress| ControlFlow::Continue(());
                let mut control = Control::new(&mut callback, CancelToken::new());
                Ok(encoder.run(x, &mut control)?.latent)
            });
        }
    }
}
