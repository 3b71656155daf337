//! How much memory a fit takes.

use super::direct;
use super::finish;
use crate::capture::Capture;
use crate::fit::Way;
use crate::memory;
use crate::nn::Model;

/// Estimated bytes at the peak of a fit, of which the capture and the weights are there before it.
pub(crate) fn estimate(capture: &Capture, model: Option<&Model>, way: Way<'_>) -> Estimate {
    let in_use = capture.memory().saturating_add(model.map_or(0, Model::memory));
    let pixels = (capture.width() * capture.height()) as u64;
    let (photos, maps) = (capture.len(), pixels * 10 * 4);
    let size = (capture.width(), capture.height());
    let beside = match way {
        Way::Direct => direct::memory(photos, size, false),
        Way::Paper(network) => {
            // Encoded photos and what is saturated in them; maps and their gradient; the material and what is rendered of it.
            let common = photos as u64 * (3 * 4 + 1) + 2 * 14 * 4 + (14 + 6) * 4;
            pixels * common + network.fit_memory(capture.height(), capture.width())
        }
        Way::Graph(graph) => {
            // What the network predicts: nine planes and their deviations.
            let kept = 2 * 9 * 4 * pixels + maps;
            let after = direct::memory(photos, size, true).max(finish::memory(photos, pixels));
            graph.memory(photos, capture.height(), capture.width()).max(kept.saturating_add(after))
        }
    };
    let threads = match way {
        Way::Direct => 0,
        _ => THREAD * rayon::current_num_threads() as u64 + memory::SMALL,
    };
    Estimate { in_use, peak: in_use.saturating_add(beside).saturating_add(threads + memory::SMALL) }
}

/// What every thread keeps for products of matrices: the size of its second cache, on most machines no more than this.
const THREAD: u64 = 9 << 18;

/// See [`estimate`].
pub(crate) struct Estimate {
    pub in_use: u64,
    pub peak: u64,
}
