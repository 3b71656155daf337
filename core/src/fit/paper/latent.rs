//! First stage of the network fit: Adam on the latent code (paper, Section 3.3, Eq. 6), by gradients from dfdx's tape: decoder, adapters, maps and loss.

use crate::error::Result;
use crate::fit::optim::descent::{Descent, EarlyStop, Settings, descend};
use crate::fit::paper::adapters::Readout;
use crate::nn::{AdapterParams, Code, Network};
use crate::progress::{Control, Stage};

/// Moves the latent code of `code` so that the rendering of the maps that `readout` has from the decoded feature matches its targets.
/// The best latent code is left in `code` and its feature in `readout`. Decoder, skips and `adapters` stay as they are.
///
/// `steps` steps of Adam at a learning rate of 1e-3, with a single photo 1e-4, or fewer as `early_stop` has it. A cancelled run returns
/// between two blocks of the decoder, on the way there or back.
///
/// # Errors
/// [`Error::ShapeMismatch`](crate::Error::ShapeMismatch) if sizes do not fit together; [`Error::Cancelled`](crate::Error::Cancelled);
/// [`Error::NonFinite`](crate::Error::NonFinite) if the loss is not finite from the start.
pub fn fit_latent(
    network: &Network,
    code: &mut Code,
    adapters: &[AdapterParams],
    readout: &mut Readout<'_>,
    steps: usize,
    early_stop: Option<EarlyStop>,
    control: &mut Control<'_>,
) -> Result<Descent> {
    let params: Vec<f32> = adapters.iter().flat_map(|adapter| &adapter.values).copied().collect();
    let settings = Settings {
        stage: Stage::Latent,
        steps,
        learning_rate: readout.learning_rate(),
        final_rate: 1.0,
        early_stop,
        around: [0; 2],
    };
    let mut latent = std::mem::take(&mut code.latent);
    let result = descend(&mut latent, &settings, control, |latent, gradient, control| match gradient {
        Some(gradient) => {
            let (_, trace) = network.decode_traced(latent, code, control)?;
            let (loss, slope) = trace.descend(|feature| readout.loss_on_tape(&params, feature), control)?;
            gradient.copy_from_slice(&slope);
            Ok(loss)
        }
        None => {
            readout.set_feature(&network.decode(latent, code, control)?)?;
            readout.loss(&params, None, None, control)
        }
    });
    code.latent = latent;
    let descent = result?;
    if descent.best_step != descent.steps {
        // The last code evaluated was not the best.
        readout.set_feature(&network.decode(&code.latent, code, control)?)?;
    }
    Ok(descent)
}
