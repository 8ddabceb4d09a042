//! Faults that are injected into emulated drives on purpose, as the command line names them.

use core::fmt;
use core::str::FromStr;
use std::cell::RefCell;
use std::rc::Rc;

use hal::can::bus::{Network, Tampering, Terminal};
use hal::can::cia301::Cob;
use hal::can::cia301::emcy::{ErrorCode, register};
use hal::can::{Frame, NodeId, Payload};

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultKind {
    /// The node loses its power and its place on the bus.
    Pull,
    /// The node is reset and boots up.
    Reboot,
    /// The drive fails by itself with this code.
    Emergency(ErrorCode),
    /// The motor turns nothing any more: its axis is limp, the drive thinks otherwise.
    Slack,
    /// The node's answers to SYNC get lost.
    Silence,
    /// The node's answers come a cycle and a half late.
    Late,
    /// The node's answers are a byte too short.
    Short,
    /// The node's answers make no sense.
    Garbage,
    /// The node's heartbeats get lost.
    NoHeartbeat,
    /// The node says that it is another make, from the start.
    WrongIdentity,
    /// The controllers of all others on the bus count too many errors and leave it.
    BusOff,
    /// Somebody else gives the beat on the bus.
    ForeignMaster,
}

/// Names of the kinds on the command line.
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

/// A fault with its place and time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InjectedFault {
    /// What.
    pub kind: FaultKind,
    /// The drive; of a fault of a bus, one that is on it.
    pub node: NodeId,
    /// When: after all drives were first enabled, ns.
    pub at_ns: u64,
    /// How long, ns; for good if not given.
    pub for_ns: Option<u64>,
    /// As it was typed.
    text: String,
}

impl fmt::Display for InjectedFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// A fault that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct BadFault(String);

impl FromStr for InjectedFault {
    type Err = BadFault;

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

fn parse_kind(value: &str) -> Result<FaultKind, BadFault> {
    let found = KINDS.iter().find(|(name, _)| *name == value);
    found.map(|(_, kind)| *kind).ok_or_else(|| {
        let names: Vec<&str> = KINDS.iter().map(|(name, _)| *name).collect();
        BadFault(format!("kind={value}: there are {}", names.join(", ")))
    })
}

fn parse_node(value: &str) -> Result<NodeId, BadFault> {
    let node = value.parse().ok().and_then(NodeId::new);
    node.ok_or_else(|| BadFault(format!("node={value}: a node is 1 to 127")))
}

/// `2s`, `1.5s` or `150ms`, ns.
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

fn parse_code(value: &str) -> Result<ErrorCode, BadFault> {
    let digits = value.strip_prefix("0x").unwrap_or(value);
    let code = u16::from_str_radix(digits, 16)
        .ok()
        .filter(|code| *code > 0);
    code.map(ErrorCode)
        .ok_or_else(|| BadFault(format!("code={value}: a code is 0x0001 to 0xFFFF")))
}

/// A frame of `node` that something happens to.
#[derive(Clone, Copy, Debug)]
struct Meddling {
    kind: FaultKind,
    node: NodeId,
    delay_ns: u64,
}

impl Meddling {
    fn of(&self, frame: &Frame) -> Option<Tampering> {
        let answer = matches!(Cob::of(frame.id), Cob::TransmitPdo(_, node) if node == self.node);
        let beat = matches!(Cob::of(frame.id), Cob::Heartbeat(node) if node == self.node);
        let replaced =
            |data: &[u8]| Tampering::Replace(Frame::new(frame.id, Payload::truncated(data)));
        match self.kind {
            FaultKind::Silence if answer => Some(Tampering::Drop),
            FaultKind::Late if answer => Some(Tampering::Delay(self.delay_ns)),
            FaultKind::Short if answer => {
                let length = frame.data().len().saturating_sub(1);
                Some(replaced(&frame.data()[..length]))
            }
            FaultKind::Garbage if answer => Some(replaced(&[0xFF; 8])),
            FaultKind::NoHeartbeat if beat => Some(Tampering::Drop),
            _ => None,
        }
    }
}

/// What a fault needs of the process around the drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outside {
    /// The axis of this node is limp, or not any more.
    Slack(NodeId, bool),
    /// The bus that this node is on tells everybody that their controllers are off.
    BusOff(NodeId),
    /// Somebody else gives the beat of the arm that this node belongs to.
    ForeignMaster(NodeId),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Waiting,
    Active,
    Over,
}

/// The faults of a run, and what is left of them.
pub(super) struct Injector {
    faults: Vec<(InjectedFault, Stage)>,
    meddling: Rc<RefCell<Vec<Meddling>>>,
    cycle_ns: u64,
}

impl Injector {
    /// Prepares `faults` on `network`, whose drives are led every `cycle_ns`.
    pub(super) fn new(
        faults: &[InjectedFault],
        cycle_ns: u64,
        network: &mut Network<Terminal>,
    ) -> Self {
        let meddling = Rc::new(RefCell::new(Vec::<Meddling>::new()));
        if !faults.is_empty() {
            let active = Rc::clone(&meddling);
            network.tamper(Box::new(move |_, _, frame| {
                let active = active.borrow();
                let what = active.iter().find_map(|meddling| meddling.of(frame));
                what.unwrap_or(Tampering::Pass)
            }));
        }
        let waiting = faults.iter().map(|fault| (fault.clone(), Stage::Waiting));
        Self {
            faults: waiting.collect(),
            meddling,
            cycle_ns,
        }
    }

    /// Begins and ends what is due so long after the drives were enabled; `outside` does what is not the drives'. Gives the
    /// place of the fault that has just begun, if one has.
    pub(super) fn turn(
        &mut self,
        since_ns: u64,
        network: &mut Network<Terminal>,
        outside: &mut dyn FnMut(Outside, &mut Network<Terminal>),
    ) -> Option<usize> {
        let mut begun = None;
        for place in 0..self.faults.len() {
            let (fault, stage) = &mut self.faults[place];
            let end_ns = fault.for_ns.map(|for_ns| fault.at_ns + for_ns);
            let fault = fault.clone();
            match stage {
                Stage::Waiting if since_ns >= fault.at_ns => {
                    *stage = Stage::Active;
                    begun = Some(place);
                    self.begin(&fault, network, outside);
                }
                Stage::Active if end_ns.is_some_and(|end_ns| since_ns >= end_ns) => {
                    *stage = Stage::Over;
                    self.end(&fault, network, outside);
                }
                Stage::Waiting | Stage::Active | Stage::Over => {}
            }
        }
        begun
    }

    fn begin(
        &self,
        fault: &InjectedFault,
        network: &mut Network<Terminal>,
        outside: &mut dyn FnMut(Outside, &mut Network<Terminal>),
    ) {
        let node = fault.node;
        match fault.kind {
            FaultKind::Pull => {
                network.power(node, false);
                if let Some(motor) = network.motor(node) {
                    *motor = Terminal::new(motor.feedback);
                }
            }
            FaultKind::Reboot => {
                network.poke(node, |now, node, out| node.power_on(now, out));
            }
            FaultKind::Emergency(code) => network.poke(node, |now, node, out| {
                node.fail(now, code, register_of(code), out);
            }),
            FaultKind::Slack => outside(Outside::Slack(node, true), network),
            FaultKind::BusOff => outside(Outside::BusOff(node), network),
            FaultKind::ForeignMaster => outside(Outside::ForeignMaster(node), network),
            FaultKind::Silence
            | FaultKind::Late
            | FaultKind::Short
            | FaultKind::Garbage
            | FaultKind::NoHeartbeat => self.meddling.borrow_mut().push(Meddling {
                kind: fault.kind,
                node,
                delay_ns: self.cycle_ns * 3 / 2,
            }),
            // It was so from the start.
            FaultKind::WrongIdentity => {}
        }
    }

    fn end(
        &self,
        fault: &InjectedFault,
        network: &mut Network<Terminal>,
        outside: &mut dyn FnMut(Outside, &mut Network<Terminal>),
    ) {
        let node = fault.node;
        match fault.kind {
            FaultKind::Pull => network.power(node, true),
            FaultKind::Slack => outside(Outside::Slack(node, false), network),
            FaultKind::Silence
            | FaultKind::Late
            | FaultKind::Short
            | FaultKind::Garbage
            | FaultKind::NoHeartbeat => self
                .meddling
                .borrow_mut()
                .retain(|active| (active.kind, active.node) != (fault.kind, node)),
            FaultKind::Reboot
            | FaultKind::Emergency(_)
            | FaultKind::BusOff
            | FaultKind::ForeignMaster
            | FaultKind::WrongIdentity => {}
        }
    }
}

/// The bit of 1001h that goes with a drive's own error.
const fn register_of(code: ErrorCode) -> u8 {
    match code.0 >> 12 {
        0x2 => register::CURRENT,
        0x3 => register::VOLTAGE,
        0x4 => register::TEMPERATURE,
        0x8 => register::PROFILE,
        _ => register::GENERIC,
    }
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
