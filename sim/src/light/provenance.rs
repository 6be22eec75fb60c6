//! Where numbers come from: the comment lines at the top of a table.
//!
//! `# status: measured`, `# source: …`, `# uncertainty: …`, `# licence: …`, `# note: …`, in any order before the
//! header line; a key may come again and goes on. Other comments are comments.

use std::fmt;

/// What kind of numbers a table holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// A published measurement, re-gridded at most.
    Measured,
    /// Computed from cited figures.
    Model,
    /// A placeholder.
    Assumed,
}

impl Status {
    /// All of them with their words.
    pub const WORDS: [(Self, &str); 3] =
        [(Self::Measured, "measured"), (Self::Model, "model"), (Self::Assumed, "assumed")];

    /// The status of a word.
    pub fn of_word(word: &str) -> Option<Self> {
        Self::WORDS.iter().find(|(_, own)| own.eq_ignore_ascii_case(word)).map(|(status, _)| *status)
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = Self::WORDS.iter().find(|(status, _)| status == self);
        f.pad(words.map_or("", |(_, word)| *word))
    }
}

/// Status, source, uncertainty and licence of a table; empty where the file does not say.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Provenance {
    /// Kind of numbers, if the file says.
    pub status: Option<Status>,
    /// Who measured or computed them, with the place of publication.
    pub source: String,
    /// How far they can be wrong.
    pub uncertainty: String,
    /// Licence of the numbers.
    pub licence: String,
    /// Anything else a user should know.
    pub note: String,
}

impl Provenance {
    /// Takes in one comment line, without its `#`.
    ///
    /// # Errors
    ///
    /// The word after `status:` when it is none of [`Status::WORDS`].
    pub fn take_in(&mut self, comment: &str) -> Result<(), String> {
        let Some((key, value)) = comment.split_once(':') else { return Ok(()) };
        let value = value.trim();
        let text = match key.trim().to_ascii_lowercase().as_str() {
            "status" => {
                self.status = Some(Status::of_word(value).ok_or_else(|| value.to_owned())?);
                return Ok(());
            }
            "source" => &mut self.source,
            "uncertainty" => &mut self.uncertainty,
            "licence" | "license" => &mut self.licence,
            "note" => &mut self.note,
            _ => return Ok(()),
        };
        if !text.is_empty() {
            text.push_str("; ");
        }
        text.push_str(value);
        Ok(())
    }
}

/// `measured: SOURCE (UNCERTAINTY)`; what is not known says so.
impl fmt::Display for Provenance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.status {
            Some(status) => write!(f, "{status}: ")?,
            None => f.write_str("status not stated: ")?,
        }
        f.write_str(if self.source.is_empty() { "source not stated" } else { &self.source })?;
        if !self.uncertainty.is_empty() {
            write!(f, " ({})", self.uncertainty)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_keys_are_kept_and_the_rest_is_a_comment() {
        let mut own = Provenance::default();
        assert_eq!(own.to_string(), "status not stated: source not stated");
        for line in [" Status: Measured", "source: A, B 1 (2000)", "source: C", "https: //x", "free words"] {
            own.take_in(line).unwrap();
        }
        assert_eq!(own.status, Some(Status::Measured));
        own.take_in(" uncertainty: 3 %").unwrap();
        assert_eq!(own.to_string(), "measured: A, B 1 (2000); C (3 %)");
        assert_eq!(own.take_in("status: guessed"), Err("guessed".to_owned()));
    }
}
