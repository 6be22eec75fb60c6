//! What a feature of the camera is: its register, its type and the values it takes.
//!
//! One table of these makes both the register block and the GenICam description, so that they cannot disagree. Knows
//! nothing of what a feature does.

use super::gvcp::Status;

/// First address of the features' registers.
pub(super) const FEATURES_BASE: u32 = 0x0001_0000;

/// What a client may do with a feature.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Access {
    /// Read only.
    ReadOnly,
    /// Read and write at any time.
    ReadWrite,
    /// Read and write, but no write while the stream runs.
    Locked,
    /// Write only (commands).
    WriteOnly,
}

/// A limit of an integer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Bound {
    /// Fixed.
    Value(i64),
    /// The present value of another feature.
    Feature(&'static str),
}

/// Type and range.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Kind {
    /// Unsigned, 4 bytes.
    Integer {
        /// Least value.
        min: Bound,
        /// Greatest value.
        max: Bound,
        /// Grain, counted from 0.
        inc: i64,
    },
    /// IEEE double, 8 bytes.
    Float {
        /// Least value.
        min: f64,
        /// Greatest value.
        max: f64,
        /// Grain to which a written value is rounded; absent = none.
        inc: Option<f64>,
        /// Unit, for display.
        unit: &'static str,
    },
    /// Names for values of 4 bytes.
    Enumeration(Vec<(&'static str, u32)>),
    /// 0 or 1 in 4 bytes.
    Boolean,
    /// Acts when 1 is written.
    Command,
}

/// One feature.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Feature {
    /// Name.
    pub(super) name: &'static str,
    /// Category; empty = hidden.
    pub(super) category: &'static str,
    /// One sentence.
    pub(super) text: &'static str,
    /// What a client may do.
    pub(super) access: Access,
    /// Type and range.
    pub(super) kind: Kind,
    /// Address of its register; given by [`place`].
    pub(super) address: u32,
    /// The enumeration by which it is selected.
    pub(super) selector: Option<&'static str>,
    /// Value after switching on.
    pub(super) initial: Vec<u8>,
}

impl Kind {
    /// Bytes of the register.
    pub(super) fn bytes(&self) -> u32 {
        match self {
            Self::Float { .. } => 8,
            _ => 4,
        }
    }

    /// The register's bytes after writing `bytes`, rounded to the grain.
    ///
    /// # Errors
    /// [`Status::InvalidParameter`] for a value that the feature does not take. `bound` gives the present value of another
    /// feature.
    pub(super) fn accept(&self, bytes: &[u8], bound: impl Fn(&str) -> i64) -> Result<Vec<u8>, Status> {
        let good = match self {
            Self::Integer { min, max, inc } => {
                let value = i64::from(word(bytes));
                let limit = |limit: &Bound| match limit {
                    Bound::Value(value) => *value,
                    Bound::Feature(name) => bound(name),
                };
                (limit(min)..=limit(max)).contains(&value) && value % inc == 0
            }
            Self::Float { min, max, inc, .. } => {
                let value = double(bytes);
                // Half a grain beyond a limit is a rounding of the client's.
                let slack = inc.unwrap_or(0.0) / 2.0;
                if !(min - slack..=max + slack).contains(&value) {
                    return Err(Status::InvalidParameter);
                }
                let rounded = inc.map_or(value, |inc| (value / inc).round() * inc);
                return Ok(rounded.clamp(*min, *max).to_be_bytes().to_vec());
            }
            Self::Enumeration(entries) => entries.iter().any(|(_, value)| *value == word(bytes)),
            Self::Boolean => word(bytes) <= 1,
            Self::Command => word(bytes) == 1,
        };
        if good { Ok(bytes.to_vec()) } else { Err(Status::InvalidParameter) }
    }
}

/// The number in a register of 4 bytes.
pub(super) fn word(bytes: &[u8]) -> u32 {
    bytes.first_chunk().map_or(0, |&chunk| u32::from_be_bytes(chunk))
}

/// The number in a register of 8 bytes.
pub(super) fn double(bytes: &[u8]) -> f64 {
    bytes.first_chunk().map_or(f64::NAN, |&chunk| f64::from_be_bytes(chunk))
}

/// Gives every feature its address, in the order of the table.
pub(super) fn place(features: &mut [Feature]) {
    let mut next = FEATURES_BASE;
    for feature in features {
        feature.address = next;
        feature.initial.resize(feature.kind.bytes() as usize, 0);
        next += feature.kind.bytes().next_multiple_of(16);
    }
}

/// Short ways to write a table.
impl Feature {
    fn new(category: &'static str, name: &'static str, access: Access, kind: Kind) -> Self {
        let initial = Vec::new();
        Self { name, category, text: "", access, kind, address: 0, selector: None, initial }
    }

    /// An integer.
    pub(super) fn integer(
        category: &'static str,
        name: &'static str,
        access: Access,
        [min, max]: [Bound; 2],
        inc: i64,
        initial: u32,
    ) -> Self {
        let feature = Self::new(category, name, access, Kind::Integer { min, max, inc });
        Self { initial: initial.to_be_bytes().to_vec(), ..feature }
    }

    /// An integer that only the camera changes.
    pub(super) fn count(category: &'static str, name: &'static str, initial: u32) -> Self {
        let limits = [Bound::Value(0), Bound::Value(i64::from(u32::MAX))];
        Self::integer(category, name, Access::ReadOnly, limits, 1, initial)
    }

    /// A number with a unit.
    pub(super) fn float(
        category: &'static str,
        name: &'static str,
        access: Access,
        [min, max, inc]: [f64; 3],
        unit: &'static str,
        initial: f64,
    ) -> Self {
        let inc = (inc > 0.0).then_some(inc);
        let feature = Self::new(category, name, access, Kind::Float { min, max, inc, unit });
        Self { initial: initial.to_be_bytes().to_vec(), ..feature }
    }

    /// An enumeration; it starts with its first entry.
    pub(super) fn enumeration(
        category: &'static str,
        name: &'static str,
        access: Access,
        entries: &[(&'static str, u32)],
    ) -> Self {
        let initial = entries.first().map_or(0, |entry| entry.1).to_be_bytes().to_vec();
        Self { initial, ..Self::new(category, name, access, Kind::Enumeration(entries.to_vec())) }
    }

    /// A switch, off at first.
    pub(super) fn boolean(category: &'static str, name: &'static str, access: Access) -> Self {
        Self::new(category, name, access, Kind::Boolean)
    }

    /// A command.
    pub(super) fn command(category: &'static str, name: &'static str) -> Self {
        Self::new(category, name, Access::WriteOnly, Kind::Command)
    }

    /// With a sentence for the reader.
    pub(super) fn says(self, text: &'static str) -> Self {
        Self { text, ..self }
    }

    /// One of several values, chosen by the enumeration `selector`.
    pub(super) fn selected_by(self, selector: &'static str) -> Self {
        Self { selector: Some(selector), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_checked_and_rounded_to_the_grain() {
        let fixed = |_: &str| 640;
        let kind = Kind::Integer { min: Bound::Value(16), max: Bound::Feature("Room"), inc: 4 };
        let try_word = |kind: &Kind, value: u32| kind.accept(&value.to_be_bytes(), fixed).is_ok();
        assert!(try_word(&kind, 16) && try_word(&kind, 640));
        assert!(!try_word(&kind, 12) && !try_word(&kind, 644) && !try_word(&kind, 18));
        let kind = Kind::Float { min: 1.0, max: 10_000.0, inc: Some(0.1), unit: "us" };
        let told = |value: f64| kind.accept(&value.to_be_bytes(), fixed).map(|bytes| double(&bytes));
        assert!((told(25.04).unwrap() - 25.0).abs() < 1e-12);
        assert!((told(0.96).unwrap() - 1.0).abs() < 1e-12);
        for wrong in [0.9, 10_000.2, f64::NAN, f64::INFINITY, -1.0] {
            assert_eq!(told(wrong), Err(Status::InvalidParameter), "{wrong}");
        }
        let kind = Kind::Enumeration(vec![("Software", 0), ("ExternalSignal", 48)]);
        assert!(try_word(&kind, 48) && !try_word(&kind, 1));
        assert!(try_word(&Kind::Boolean, 1) && !try_word(&Kind::Boolean, 2));
    }

    #[test]
    fn registers_do_not_overlap() {
        let mut features = vec![
            Feature::boolean("A", "First", Access::ReadWrite),
            Feature::float("A", "Second", Access::ReadWrite, [0.0, 1.0, 0.0], "s", 0.5),
            Feature::count("A", "Third", 7),
        ];
        place(&mut features);
        for pair in features.windows(2) {
            assert!(pair[0].address + pair[0].kind.bytes() <= pair[1].address);
        }
        assert_eq!(word(&features[2].initial), 7);
    }
}
