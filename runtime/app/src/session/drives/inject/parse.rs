//! Faults as they are typed: `kind=KIND,node=N[,at=2s][,for=100ms][,code=0x4310]`.
//!
//! The same text is what a fault is called on the terminal and on pages, so it is kept as it was
//! typed. Keys come in any order; one that is given twice counts as its last value says. Whether
//! the node exists is checked by `run_drives`, which knows the buses.

use core::str::FromStr;

use trocar_canopen::NodeId;
use trocar_canopen::cia301::emcy::ErrorCode;

use super::{FaultKind, InjectedFault};

/// Names of the kinds on the command line.
///
/// `emcy` stands for over-temperature of the drive, 4310h, unless `code=` says another. Of the
/// others only `following-error`, which is an emergency too, takes a code.
const KINDS: [(&str, FaultKind); 13] = [
    ("pull", FaultKind::Pull),
    ("reboot", FaultKind::Reboot),
    ("emcy", FaultKind::Emergency(ErrorCode(0x4310))),
    (
        "following-error",
        FaultKind::Emergency(ErrorCode::FOLLOWING_ERROR),
    ),
    ("slack", FaultKind::Slack),
    ("silence", FaultKind::Silence),
    ("late", FaultKind::Late),
    ("short", FaultKind::Short),
    ("garbage", FaultKind::Garbage),
    ("no-heartbeat", FaultKind::NoHeartbeat),
    ("wrong-identity", FaultKind::WrongIdentity),
    ("bus-off", FaultKind::BusOff),
    ("foreign-master", FaultKind::ForeignMaster),
];

/// A fault that cannot be read.
///
/// The whole line for a person, without the option's name: which key, its value, and what is
/// allowed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct BadFault(String);

impl FromStr for InjectedFault {
    type Err = BadFault;

    /// `at=` is 0 if it is not given, and then the fault begins with the episode. No blanks are
    /// allowed around `,` and `=`.
    fn from_str(text: &str) -> Result<Self, BadFault> {
        let (mut kind, mut node, mut at_ns, mut for_ns, mut code) = (None, None, 0, None, None);
        for part in text.split(',') {
            let (key, value) = part
                .split_once('=')
                .ok_or_else(|| BadFault(format!("{part:?} is not KEY=VALUE")))?;
            match key {
                "kind" => kind = Some(parse_kind(value)?),
                "node" => node = Some(parse_node(value)?),
                "at" => at_ns = parse_time(key, value)?,
                "for" => for_ns = Some(parse_time(key, value)?),
                "code" => code = Some(parse_code(value)?),
                other => {
                    return Err(BadFault(format!(
                        "{other:?}: there are kind, node, at, for and code"
                    )));
                }
            }
        }
        let missing = |key: &str| BadFault(format!("{key}= is missing"));
        let kind = match (kind.ok_or_else(|| missing("kind"))?, code) {
            (FaultKind::Emergency(_), Some(code)) => FaultKind::Emergency(code),
            (_, Some(_)) => return Err(BadFault("code= goes with kind=emcy alone".to_owned())),
            (kind, None) => kind,
        };
        Ok(Self {
            kind,
            node: node.ok_or_else(|| missing("node"))?,
            at_ns,
            for_ns,
            text: text.to_owned(),
        })
    }
}

/// Exact, lower case; the error lists all kinds.
fn parse_kind(value: &str) -> Result<FaultKind, BadFault> {
    let found = KINDS.iter().find(|(name, _)| *name == value);
    found.map(|(_, kind)| *kind).ok_or_else(|| {
        let names: Vec<&str> = KINDS.iter().map(|(name, _)| *name).collect();
        BadFault(format!("kind={value}: there are {}", names.join(", ")))
    })
}

/// 1 to 127, as CiA 301 numbers nodes.
fn parse_node(value: &str) -> Result<NodeId, BadFault> {
    let node = value.parse().ok().and_then(NodeId::new);
    node.ok_or_else(|| BadFault(format!("node={value}: a node is 1 to 127")))
}

/// `2s`, `1.5s` or `150ms`, ns. 0 to 3600 s, rounded to whole microseconds; negative times and NaN
/// are refused. `ms` is tried before `s`, since both end in the same letter.
fn parse_time(key: &str, value: &str) -> Result<u64, BadFault> {
    let (number, scale) = match (value.strip_suffix("ms"), value.strip_suffix('s')) {
        (Some(number), _) => (number, 1.0),
        (None, Some(number)) => (number, 1e3),
        (None, None) => (value, f64::NAN),
    };
    let ms = number.parse::<f64>().unwrap_or(f64::NAN) * scale;
    if !(0.0..=3.6e6).contains(&ms) {
        let range = "a time is 0 to 3600 s, as 2s or 150ms";
        return Err(BadFault(format!("{key}={value}: {range}")));
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the range was just checked"
    )]
    let whole_us = (ms * 1e3).round() as u64;
    Ok(whole_us * 1000)
}

/// Hexadecimal with or without `0x`. 0000h is refused: it means that an error was reset.
fn parse_code(value: &str) -> Result<ErrorCode, BadFault> {
    let digits = value.strip_prefix("0x").unwrap_or(value);
    let code = u16::from_str_radix(digits, 16)
        .ok()
        .filter(|code| *code > 0);
    code.map(ErrorCode)
        .ok_or_else(|| BadFault(format!("code={value}: a code is 0x0001 to 0xFFFF")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS_NS: u64 = 1_000_000;

    fn read(text: &str) -> Result<InjectedFault, String> {
        text.parse::<InjectedFault>()
            .map_err(|error| error.to_string())
    }

    #[test]
    fn faults_are_read_with_their_times() {
        let fault = read("node=3,at=1.5s,kind=silence,for=250ms").unwrap();
        assert_eq!(fault.kind, FaultKind::Silence);
        assert_eq!(fault.node.raw(), 3);
        assert_eq!(fault.at_ns, 1500 * MS_NS);
        assert_eq!(fault.for_ns, Some(250 * MS_NS));
        let emcy = read("kind=emcy,node=7,code=0x2310").unwrap();
        assert_eq!(emcy.kind, FaultKind::Emergency(ErrorCode(0x2310)));
        assert_eq!((emcy.at_ns, emcy.for_ns), (0, None));
        for (name, _) in KINDS {
            assert!(read(&format!("kind={name},node=1")).is_ok(), "{name}");
        }
    }

    #[test]
    fn nonsense_is_named() {
        for (text, expected) in [
            ("kind=fire,node=1", "kind=fire: there are pull, "),
            ("kind=pull", "node= is missing"),
            ("node=1", "kind= is missing"),
            ("kind=pull,node=200", "node=200: a node is 1 to 127"),
            ("kind=pull,node=1,at=soon", "at=soon: a time is"),
            ("kind=pull,node=1,at=-2s", "at=-2s: a time is"),
            ("kind=pull,node=1,at=NaNs", "at=NaNs: a time is"),
            ("kind=pull,node=1,code=0x1000", "code= goes with"),
            ("kind=emcy,node=1,code=0", "code=0: a code is"),
            ("pull", "\"pull\" is not KEY=VALUE"),
            ("kind=pull,node=1,why=1", "\"why\": there are"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.starts_with(expected), "{text}: {error}");
        }
    }
}
