//! Units of length.

use serde::{Deserialize, Serialize};

/// A unit of length by its name. `mm`, `cm`, `m` and `in` are known: lengths in one of them can be told in another. Any other name is a unit
/// of its own.
///
/// # Example
/// ```
/// use svbrdf_gcn::Unit;
///
/// assert_eq!(Unit::new("in").factor_to(&Unit::new("cm")), Some(2.54));
/// assert_eq!(Unit::new("tiles").factor_to(&Unit::new("tiles")), Some(1.0));
/// assert_eq!(Unit::new("tiles").factor_to(&Unit::new("cm")), None);
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Unit(String);

impl Unit {
    /// The known units, in micrometres: whole numbers, so that their ratios are rounded once.
    const KNOWN: [(&str, u32); 4] = [("mm", 1_000), ("cm", 10_000), ("m", 1_000_000), ("in", 25_400)];

    /// The unit of this name, exactly as it is written.
    pub fn new(name: impl Into<String>) -> Self {
        Self(name.into())
    }

    /// The unit's name.
    pub fn name(&self) -> &str {
        &self.0
    }

    fn micrometres(&self) -> Option<u32> {
        Self::KNOWN.iter().find(|(name, _)| *name == self.0).map(|&(_, micrometres)| micrometres)
    }

    /// What lengths in this unit are multiplied by to be lengths in `other`: 1 for the same unit; `None` if one of two is not known.
    pub fn factor_to(&self, other: &Self) -> Option<f64> {
        if self == other {
            return Some(1.0);
        }
        Some(f64::from(self.micrometres()?) / f64::from(other.micrometres()?))
    }
}

impl std::fmt::Display for Unit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_units_convert_and_others_equal_only_themselves() {
        let factor = |from: &str, to: &str| Unit::new(from).factor_to(&Unit::new(to));
        for (from, to, expected) in [
            ("mm", "cm", 0.1),
            ("cm", "mm", 10.0),
            ("m", "cm", 100.0),
            ("cm", "m", 0.01),
            ("m", "mm", 1000.0),
            ("in", "mm", 25.4),
            ("in", "cm", 2.54),
            ("m", "m", 1.0),
            ("halves", "halves", 1.0),
        ] {
            assert_eq!(factor(from, to), Some(expected), "{from} {to}");
        }
        for (from, to) in [("halves", "cm"), ("cm", "halves"), ("halves", "Halves"), ("CM", "cm"), ("", "m")] {
            assert_eq!(factor(from, to), None, "{from} {to}");
        }
    }
}
