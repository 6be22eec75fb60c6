//! Which known name a misspelt one may have meant.

/// Least similarity (Jaro–Winkler, 0 … 1) of a guess, as for the keys of a campaign file: one wrong, missing or doubled
/// letter in a word of four is still recognised.
const GUESS_FROM: f64 = 0.75;

/// The known name that is most like `wrong`, if one is.
pub fn guess<'a>(wrong: &str, known: &[&'a str]) -> Option<&'a str> {
    let wrong = wrong.to_lowercase();
    known
        .iter()
        .map(|name| (strsim::jaro_winkler(&name.to_lowercase(), &wrong), *name))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(similarity, _)| *similarity >= GUESS_FROM)
        .map(|(_, name)| name)
}

/// Ready for a message: ` (did you mean `NAME`?)`, or nothing.
pub(crate) fn guessed(wrong: &str, known: &[&str]) -> String {
    guess(wrong, known).map_or(String::new(), |name| format!(" (did you mean `{name}`?)"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_is_recognised_and_another_word_is_not() {
        let known = ["n-heptane", "n-octane", "toluene"];
        for (wrong, wanted) in [("heptane", "n-heptane"), ("Toluen", "toluene"), ("N-OCTANE", "n-octane")] {
            assert_eq!(guess(wrong, &known), Some(wanted));
        }
        assert_eq!(guess("water", &known), None);
        assert_eq!(guess("x", &[]), None);
    }
}
