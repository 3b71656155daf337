//! First stage of the network fit: Adam on the latent code (paper, Section 3.3, Eq. 6).

use crate::error::Result;
use crate::fit::adapters::Readout;
use crate::fit::descent::{Descent, EarlyStop, Settings, descend};
use crate::fit::progress::{Control, Stage};
use crate::nn::{AdapterParams, Code, Decoding, Network};
use crate::render::Target;

/// Learning rate for several photos, and for one (released optimisation).
const RATES: [f64; 2] = [1e-3, 1e-4];

/// Moves the latent code of `code` so that the rendering of the decoded maps matches the `targets`, and leaves the best latent code there.
/// Decoder, skips and `adapters` stay as they are.
///
/// `steps` steps of Adam at a learning rate of 1e-3, with a single photo 1e-4, or fewer as `early_stop` has it. `patch_size` is the width
/// of the patch in the unit of the targets' positions. A cancelled run returns between two blocks of the decoder, on the way there or back.
///
/// # Errors
/// [`Error::InvalidArgument`](crate::Error::InvalidArgument) if there are no targets; [`Error::ShapeMismatch`](crate::Error::ShapeMismatch)
/// if sizes do not fit together; [`Error::Cancelled`](crate::Error::Cancelled);
/// [`Error::NonFinite`](crate::Error::NonFinite) if the loss is not finite from the start.
#[allow(clippy::too_many_arguments)]
pub fn fit_latent(
    network: &Network,
    code: &mut Code,
    adapters: &[AdapterParams],
    decoding: Decoding,
    patch_size: f64,
    targets: &[Target],
    steps: usize,
    early_stop: Option<EarlyStop>,
    control: &mut Control<'_>,
) -> Result<Descent> {
    let channels = network.config().feature_channels();
    let outputs: Vec<usize> = adapters.iter().map(AdapterParams::outputs).collect();
    let params: Vec<f32> = adapters.iter().flat_map(|adapter| &adapter.values).copied().collect();
    let mut d_feature = vec![0.0; channels * code.height() * code.width()];
    let mut readout = Readout::new(&d_feature, channels, &outputs, decoding, patch_size, targets)?;
    let settings = Settings {
        stage: Stage::Latent,
        steps,
        learning_rate: RATES[usize::from(targets.len() == 1)],
        final_rate: 1.0,
        early_stop,
    };
    let mut latent = std::mem::take(&mut code.latent);
    let result = descend(&mut latent, &settings, control, |latent, gradient, control| match gradient {
        Some(gradient) => {
            let (feature, trace) = network.decode_traced(latent, code, control)?;
            readout.set_feature(&feature)?;
            let loss = readout.loss(&params, None, Some(&mut d_feature), control)?;
            gradient.copy_from_slice(&trace.pull_back(&d_feature, control)?);
            Ok(loss)
        }
        None => {
            readout.set_feature(&network.decode(latent, code, control)?)?;
            readout.loss(&params, None, None, control)
        }
    });
    code.latent = latent;
    result
}
