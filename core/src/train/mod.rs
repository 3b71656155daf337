//! Training of the default network, a [`PhotoGraph`](crate::nn::PhotoGraph), on the CPU.
//!
//! The paper (Luo et al. 2024, section 3.4) trains on the L1 distance of maps and of renderings with Adam; [`losses`] states what is compared here,
//! [`optimiser`] how parameters move, and [`trainer`] has both take a step on a [`batch`].

pub(crate) mod batch;
pub(crate) mod config;
mod losses;
mod optimiser;
mod start;
pub(crate) mod trainer;

#[cfg(test)]
mod tests;
