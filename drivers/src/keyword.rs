//! Keywords with a short and a long form, as instruments of the SCPI kind spell them.
//!
//! A pattern such as `SOURce:LIST:SPOint#` names the short form in capitals, the optional rest in small letters and
//! a numeric suffix by `#`. Knows no command of any instrument.

/// How a path of keywords compares with a pattern.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fit {
    /// Another path.
    No,
    /// This path; with the number that stood in the place of `#`, if one did.
    Yes(Option<u32>),
}

/// Compares a path such as `sour:list:spo3` with a pattern such as `SOURce:LIST:SPOint#`.
///
/// Letters compare without regard to case; anything between the short and the long form does not fit.
pub(crate) fn path_fits(pattern: &str, given: &str) -> Fit {
    let mut patterns = pattern.split(':');
    let mut words = given.split(':');
    let mut number = None;
    loop {
        match (patterns.next(), words.next()) {
            (None, None) => return Fit::Yes(number),
            (Some(pattern), Some(word)) => match word_fits(pattern, word) {
                Fit::No => return Fit::No,
                Fit::Yes(found) => number = number.or(found),
            },
            _ => return Fit::No,
        }
    }
}

/// Compares one keyword with its pattern.
pub(crate) fn word_fits(pattern: &str, word: &str) -> Fit {
    let (pattern, stem, number) = match pattern.strip_suffix('#') {
        None => (pattern, word, None),
        Some(pattern) => {
            let stem = word.trim_end_matches(|c: char| c.is_ascii_digit());
            let digits = &word[stem.len()..];
            match digits.parse() {
                Ok(number) => (pattern, stem, Some(number)),
                Err(_) if digits.is_empty() => (pattern, stem, None),
                Err(_) => return Fit::No,
            }
        }
    };
    let short: String = pattern.chars().filter(|c| !c.is_ascii_lowercase()).collect();
    if stem.eq_ignore_ascii_case(pattern) || stem.eq_ignore_ascii_case(&short) {
        Fit::Yes(number)
    } else {
        Fit::No
    }
}

/// Puts a number in the place of `#` in a spelling such as `:PULSE#:STATE`; without a number `#` vanishes.
pub(crate) fn spell(spelling: &str, number: Option<u32>) -> String {
    match number {
        Some(number) => spelling.replace('#', &number.to_string()),
        None => spelling.replace('#', ""),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_short_and_the_long_form_fit() {
        assert_eq!(word_fits("POLarity", "pol"), Fit::Yes(None));
        assert_eq!(word_fits("POLarity", "POLARITY"), Fit::Yes(None));
        assert_eq!(word_fits("POLarity", "POLAR"), Fit::No);
    }

    #[test]
    fn a_suffix_is_taken_from_any_word_of_the_path() {
        assert_eq!(path_fits("PULSe#:STATe", "PULSE12:STAT"), Fit::Yes(Some(12)));
        assert_eq!(path_fits("PULSe#:STATe", "PULS:STATE"), Fit::Yes(None));
        assert_eq!(path_fits("PULSe#:STATe", "PULS1"), Fit::No);
        assert_eq!(path_fits("PULSe#:STATe", "PULS99999999999:STAT"), Fit::No);
        assert_eq!(spell(":PULSE#:STATE", Some(2)), ":PULSE2:STATE");
    }
}
