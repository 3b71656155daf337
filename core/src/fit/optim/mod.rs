//! What the stages share: Adam, the loop around it, and the photos and pixels that are held out to judge a fit.

pub mod adam;
pub mod descent;
pub(crate) mod holdout;
