//! Commands and replies of a 9132 to text and back.

/// What a command is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Header {
    /// `s`: set-point.
    SetPoint,
    /// `t`: temperature.
    Temperature,
    /// `u`: unit.
    Unit,
    /// `sc`: scan on or off.
    Scan,
    /// `sr`: scan rate in degrees per minute.
    ScanRate,
    /// `cu`: cutout.
    Cutout,
    /// `sa`: period of unasked readings in seconds, 0 for none.
    SamplePeriod,
    /// `du`: full (echo) or half duplex.
    Duplex,
    /// `*ver`: model and firmware.
    Version,
}

/// Header, what the driver sends, the whole word, and the fewest letters of it that are unique.
const TABLE: &[(Header, &str, &str, usize)] = &[
    (Header::SetPoint, "s", "setpoint", 1),
    (Header::Scan, "sc", "scan", 2),
    (Header::ScanRate, "sr", "srate", 2),
    (Header::SamplePeriod, "sa", "sample", 2),
    (Header::Temperature, "t", "temperature", 1),
    (Header::Unit, "u", "units", 1),
    (Header::Cutout, "cu", "cutout", 2),
    (Header::Duplex, "du", "duplex", 2),
    (Header::Version, "*ver", "*version", 2),
];

/// One command.
///
/// ```
/// use ditd_drivers::hart_9132::{Command, Header};
/// assert_eq!(Command::decode("SETPOINT = 150.0"), Some(Command::set(Header::SetPoint, "150.0")));
/// assert_eq!(Command::query(Header::Temperature).encode(), "t");
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Command {
    /// What it is about.
    pub header: Header,
    /// What stands after `=`; a query without.
    pub value: Option<String>,
}

impl Command {
    /// A query.
    pub fn query(header: Header) -> Self {
        Self { header, value: None }
    }

    /// A set.
    pub fn set(header: Header, value: &str) -> Self {
        Self { header, value: Some(value.to_owned()) }
    }

    /// The command as sent, without its line end.
    pub fn encode(&self) -> String {
        let (_, sent, ..) =
            TABLE.iter().find(|row| row.0 == self.header).expect("the table has a row for every header");
        match &self.value {
            None => (*sent).to_owned(),
            Some(value) => format!("{sent}={value}"),
        }
    }

    /// Reads a line as the unit does: any case, spaces ignored, BS erases, abbreviated words.
    pub fn decode(line: &str) -> Option<Self> {
        let mut text = String::new();
        for character in line.chars() {
            match character {
                '\u{8}' => drop(text.pop()),
                ' ' => {}
                other => text.push(other.to_ascii_lowercase()),
            }
        }
        let (word, value) = match text.split_once('=') {
            Some((word, value)) => (word, Some(value.to_owned())),
            None => (&text[..], None),
        };
        let (header, ..) = TABLE.iter().find(|(_, sent, whole, fewest)| {
            word == *sent || (word.len() >= *fewest && whole.starts_with(word))
        })?;
        Some(Self { header: *header, value })
    }
}

/// The unit of a reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// °C.
    Celsius,
    /// °F.
    Fahrenheit,
}

/// A temperature as a reply tells it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Told {
    /// The number.
    pub value: f64,
    /// Its unit, if the reply names one.
    pub scale: Option<Scale>,
}

/// Writes a reply such as `set: 150.00 C`.
pub fn encode_told(label: &str, value: f64, scale: Scale) -> String {
    format!("{label}: {value:.2} {}", if scale == Scale::Celsius { "C" } else { "F" })
}

/// Reads a temperature of a reply: `t: 149.98 C`, `set: 150.00`, `149.98 C` or `149.98`.
///
/// # Errors
/// Says what is wrong: an echo, another label than one that begins with `initial`, no number, or one that is not finite.
pub fn decode_told(text: &str, initial: char) -> Result<Told, &'static str> {
    if text.contains('=') {
        return Err("an echo of a command");
    }
    let body = match text.split_once(':') {
        None => text,
        Some((label, body)) if label.trim().to_ascii_lowercase().starts_with(initial) => body,
        Some(_) => return Err("an answer to another query"),
    };
    let mut words = body.split_whitespace();
    let number = words.next().unwrap_or_default();
    let stem = number.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let glued = &number[stem.len()..];
    let is_number =
        !stem.is_empty() && stem.bytes().all(|byte| byte.is_ascii_digit() || b"+-.".contains(&byte));
    let value =
        stem.parse::<f64>().ok().filter(|value| is_number && value.is_finite()).ok_or("expected a number")?;
    let scale = match (glued, words.next(), words.next()) {
        ("", None, None) => None,
        ("", Some(word), None) => Some(decode_scale(word)?),
        (word, None, None) => Some(decode_scale(word)?),
        _ => return Err("expected a number and its unit"),
    };
    Ok(Told { value, scale })
}

/// Reads the reply to `u`: `u: C`, `units: F`, `C`.
///
/// # Errors
/// When it names neither.
pub fn decode_unit(text: &str) -> Result<Scale, &'static str> {
    if text.contains('=') {
        return Err("an echo of a command");
    }
    let word = match text.split_once(':') {
        None => text,
        Some((label, word)) if label.trim().to_ascii_lowercase().starts_with('u') => word,
        Some(_) => return Err("an answer to another query"),
    };
    decode_scale(word.trim())
}

fn decode_scale(word: &str) -> Result<Scale, &'static str> {
    match word.to_ascii_lowercase().as_str() {
        "c" | "degc" | "celsius" => Ok(Scale::Celsius),
        "f" | "degf" | "fahrenheit" => Ok(Scale::Fahrenheit),
        _ => Err("expected C or F"),
    }
}

/// Reads the reply to the cutout's query as far as it says whether it has tripped: `cu: 400 C, in`, `out`.
pub(super) fn decode_cutout(text: &str) -> Option<bool> {
    let text = text.to_ascii_lowercase();
    let state = text.rsplit([',', ' ', ':']).find(|word| !word.is_empty())?;
    match state {
        "out" | "tripped" => Some(true),
        "in" | "ok" => Some(false),
        _ => None,
    }
}

/// Reads the reply to `*ver`: `ver.9132,1.00` and its like give model and firmware.
pub(super) fn decode_version(text: &str) -> Option<(String, String)> {
    let rest = text.trim().to_ascii_lowercase();
    let rest = rest.strip_prefix("version").or_else(|| rest.strip_prefix("ver")).unwrap_or(&rest);
    let (model, firmware) = rest.trim_start_matches(['.', ':', ' ']).split_once(',')?;
    let is_model = model.len() >= 3 && model.bytes().all(|byte| byte.is_ascii_digit());
    is_model.then(|| (model.to_owned(), firmware.trim().to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HEADERS: [Header; 9] = [
        Header::SetPoint,
        Header::Temperature,
        Header::Unit,
        Header::Scan,
        Header::ScanRate,
        Header::Cutout,
        Header::SamplePeriod,
        Header::Duplex,
        Header::Version,
    ];

    proptest! {
        #[test]
        fn any_command_survives_the_line(index in 0..HEADERS.len(), value in prop::option::of("[0-9]{1,4}\\.[0-9]")) {
            let command = Command { header: HEADERS[index], value };
            prop_assert_eq!(Command::decode(&command.encode()), Some(command.clone()));
            let spaced: String = command.encode().to_uppercase().chars().flat_map(|c| [c, ' ']).collect();
            prop_assert_eq!(Command::decode(&spaced), Some(command));
        }

        #[test]
        fn any_temperature_survives_the_line_in_every_form(centi in -6_000_i32..70_000, fahrenheit: bool) {
            let value = f64::from(centi) / 100.0;
            let scale = if fahrenheit { Scale::Fahrenheit } else { Scale::Celsius };
            let told = Told { value, scale: Some(scale) };
            let whole = encode_told("set", value, scale);
            prop_assert_eq!(decode_told(&whole, 's'), Ok(told));
            prop_assert_eq!(decode_told(whole.trim_start_matches("set: "), 's'), Ok(told));
            prop_assert_eq!(decode_told(&whole.replace(' ', ""), 's'), Ok(told));
            let bare = format!("{value:.2}");
            prop_assert_eq!(decode_told(&bare, 't'), Ok(Told { value, scale: None }));
            prop_assert!(decode_told(&whole, 't').is_err());
            let echo = format!("s={bare}");
            prop_assert!(decode_told(&echo, 's').is_err());
        }

        #[test]
        fn no_line_makes_the_codec_panic(line in "[ -~\u{8}]{0,40}") {
            drop(Command::decode(&line));
            let _ = decode_told(&line, 's');
            let _ = decode_unit(&line);
            let _ = decode_cutout(&line);
            drop(decode_version(&line));
        }
    }

    #[test]
    fn words_are_abbreviated_to_the_shortest_unique_form_and_bs_erases() {
        for (line, header) in [
            ("s", Header::SetPoint),
            ("set", Header::SetPoint),
            ("sc", Header::Scan),
            ("scan", Header::Scan),
            ("sr", Header::ScanRate),
            ("temp", Header::Temperature),
            ("sx\u{8}c", Header::Scan),
            ("*ve", Header::Version),
        ] {
            assert_eq!(Command::decode(line), Some(Command::query(header)), "{line}");
        }
        assert_eq!(Command::decode("c"), None);
        assert_eq!(Command::decode(""), None);
    }

    #[test]
    fn what_is_no_number_or_no_unit_is_rejected() {
        for text in ["", "t:", "t: NaN C", "t: --- C", "t: 1e3 C", "inf", "24,5 C", "24.5 C F", "t: 24.5 K"] {
            assert!(decode_told(text, 't').is_err(), "{text}");
        }
        for text in ["u", "u=c", "t: 24.5 C", "scan: OFF", "K", ""] {
            assert!(decode_unit(text).is_err(), "{text}");
        }
        assert_eq!(decode_unit("units: F"), Ok(Scale::Fahrenheit));
    }

    #[test]
    fn versions_and_cutouts_are_understood_where_they_can_be() {
        assert_eq!(decode_version("ver.9132,1.23"), Some(("9132".to_owned(), "1.23".to_owned())));
        assert_eq!(decode_version("version: 9133,2.0").unwrap().0, "9133");
        assert_eq!(decode_version("?"), None);
        assert_eq!(decode_cutout("cu: 400 C, in"), Some(false));
        assert_eq!(decode_cutout("cu: 400 C,out"), Some(true));
        assert_eq!(decode_cutout("cu: 400 C"), None);
    }
}
