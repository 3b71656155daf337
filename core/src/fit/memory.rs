//! How much memory a run may use.

use crate::capture::Capture;
use crate::error::{Error, Result};
use crate::fit::Way;

/// Bytes a run may use: what the caller allows, or three quarters of what is free.
pub(crate) fn allowed(max_memory: Option<u64>) -> u64 {
    max_memory.unwrap_or_else(|| {
        let mut system = sysinfo::System::new();
        system.refresh_memory();
        // A machine that does not tell sets no limit.
        match system.available_memory() {
            0 => u64::MAX,
            free => free / 4 * 3,
        }
    })
}

/// # Errors
/// [`Error::OutOfMemory`] with both values if `needed` is over what [`allowed`] says.
pub(crate) fn check(needed: u64, max_memory: Option<u64>) -> Result<()> {
    let allowed = allowed(max_memory);
    if needed > allowed { Err(Error::OutOfMemory { needed, allowed }) } else { Ok(()) }
}

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
