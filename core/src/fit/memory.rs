//! How much memory a fit takes.

use crate::capture::Capture;
use crate::fit::Way;

/// Estimated bytes a fit takes beyond the capture and the model it is given.
pub(crate) fn estimate(capture: &Capture, way: Way<'_>) -> u64 {
    let pixels = (capture.width() * capture.height()) as u64;
    // Encoded photos and what is saturated in them; maps and their gradient; the material and what is rendered of it.
    let common = capture.len() as u64 * (3 * 4 + 1) + 2 * 14 * 4 + (14 + 6) * 4;
    match way {
        // Seven parameters per pixel with gradient, best state and Adam's two moments; the start; logits' gradients; group memberships.
        Way::Direct => pixels * (common + 7 * 5 * 4 + 3 * 4 + 7 * 4 + 16),
        Way::Paper(network) => pixels * common + network.fit_memory(capture.height(), capture.width()),
        // Afterwards, the finish: nine planes each of prediction, certainty, start and result, the latter as rows too; the photos' codes; slack.
        Way::Graph(graph) => {
            let finish = 9 * 4 * 6 + 16 + capture.len() as u64 * 12;
            pixels * common + graph.memory(capture.len(), capture.height(), capture.width()).max(pixels * finish)
        }
    }
}
