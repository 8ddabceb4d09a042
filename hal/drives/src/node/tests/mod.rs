//! A node on a bench, in virtual time.

mod communication;
mod gaps;
mod limits;
mod motion;
mod pdo;
mod sdo;

use super::*;
use trocar_canopen::Payload;
use trocar_canopen::cia301::sdo::{Content, Expedited, Request, Response};
use trocar_canopen::cia301::{AbortCode, Address, NmtTarget};
use trocar_canopen::cia402::PowerState;

const MS: u64 = 1_000_000;

/// A node whose motor goes where it should, and everything that it has said.
struct Bench {
    node: Node,
    now: TimeNs,
    out: Outbox,
    said: Vec<(TimeNs, Frame)>,
    /// Where the motor is stuck.
    stuck: Option<f64>,
}

impl Bench {
    fn new() -> Self {
        let id = NodeId::new(5).unwrap();
        let mut bench = Self {
            node: Node::new(id, &AxisConfig::default()),
            now: TimeNs(0),
            out: Outbox::default(),
            said: Vec::new(),
            stuck: None,
        };
        bench.node.feedback(Feedback::default());
        bench.node.power_on(TimeNs(0), &mut bench.out);
        bench.collect();
        bench
    }

    fn collect(&mut self) {
        let now = self.now;
        self.said
            .extend(self.out.frames().iter().map(|frame| (now, *frame)));
        self.out.clear();
    }

    fn frame(&mut self, id: u16, data: &[u8]) {
        let frame = Frame::new(CanId::new(id).unwrap(), Payload::new(data).unwrap());
        self.node.on_frame(self.now, &frame, &mut self.out);
        self.collect();
    }

    /// Half a millisecond after the other, with the motor.
    fn wait_ms(&mut self, ms: u64) {
        let end = self.now.plus_ns(ms * MS);
        while self.now < end {
            self.wait_half();
        }
    }

    fn wait_half(&mut self) {
        self.now = self.now.plus_ns(MS / 2);
        let demand = self.node.demand(self.now);
        let position = self.stuck.unwrap_or(demand.position_counts);
        self.node.feedback(Feedback {
            position_counts: position,
            velocity_counts_s: demand.velocity_counts_s,
            torque_per_mille: 0.0,
        });
        self.node.on_time(self.now, &mut self.out);
        self.collect();
    }

    fn power_state(&self) -> PowerState {
        self.node.power_state()
    }

    fn nmt(&mut self, command: NmtCommand) {
        let frame = command.emit(NmtTarget::All);
        self.frame(frame.id.raw(), frame.data());
    }

    fn request(&mut self, request: Request) -> Option<Response> {
        self.said.clear();
        self.frame(0x605, request.emit().as_slice());
        let answer = self.said.iter().find(|(_, f)| f.id.raw() == 0x585)?;
        Some(Response::parse(answer.1.data()).unwrap())
    }

    fn write(&mut self, address: Address, data: &[u8]) -> Result<(), AbortCode> {
        let content = Content::Expedited(Expedited::new(data).unwrap());
        match self.request(Request::Download(address, content)) {
            Some(Response::Download(at)) if at == address => Ok(()),
            Some(Response::Abort(at, code)) if at == address => Err(code),
            other => panic!("{other:?}"),
        }
    }

    fn read(&mut self, address: Address) -> i64 {
        self.try_read(address).unwrap()
    }

    fn try_read(&mut self, address: Address) -> Result<i64, AbortCode> {
        match self.request(Request::Upload(address)) {
            Some(Response::Upload(_, Content::Expedited(data))) => {
                let mut bytes = [0; 8];
                bytes[..data.data().len()].copy_from_slice(data.data());
                Ok(i64::from_le_bytes(bytes))
            }
            Some(Response::Abort(at, code)) if at == address => Err(code),
            other => panic!("{other:?}"),
        }
    }

    /// The reference's example: controlword and target in, statusword, position and torque out,
    /// each SYNC.
    fn map_cyclic(&mut self) {
        let u32s = |value: u32| value.to_le_bytes();
        for (index, sub, value) in [
            (0x1400, 1, 0x8000_0205_u32),
            (0x1600, 1, 0x6040_0010),
            (0x1600, 2, 0x607A_0020),
            (0x1800, 1, 0xC000_0185),
            (0x1A00, 1, 0x6041_0010),
            (0x1A00, 2, 0x6064_0020),
            (0x1A00, 3, 0x6077_0010),
        ] {
            if sub == 1 && index & 0x0200 != 0 {
                assert_eq!(self.write(Address::new(index, 0), &[0]), Ok(()));
            }
            assert_eq!(
                self.write(Address::new(index, sub), &u32s(value)),
                Ok(()),
                "{index:x}"
            );
        }
        assert_eq!(self.write(Address::new(0x1600, 0), &[2]), Ok(()));
        assert_eq!(self.write(Address::new(0x1A00, 0), &[3]), Ok(()));
        assert_eq!(self.write(Address::new(0x1400, 2), &[1]), Ok(()));
        assert_eq!(self.write(Address::new(0x1800, 2), &[1]), Ok(()));
        assert_eq!(self.write(Address::new(0x1400, 1), &u32s(0x205)), Ok(()));
        assert_eq!(
            self.write(Address::new(0x1800, 1), &u32s(0x4000_0185)),
            Ok(())
        );
        assert_eq!(self.write(index::MODE, &[8]), Ok(()));
    }

    fn command(&mut self, control: u16, target: i32) {
        let [a, b] = control.to_le_bytes();
        let [c, d, e, f] = target.to_le_bytes();
        self.frame(0x205, &[a, b, c, d, e, f]);
    }

    /// One cycle of 1 ms: set-point, SYNC, time.
    fn cycle(&mut self, control: u16, target: i32) {
        self.command(control, target);
        self.frame(0x080, &[]);
        self.wait_ms(1);
    }

    /// Mapped, operational and enabled in cyclic synchronous position.
    fn enabled() -> Self {
        let mut bench = Self::new();
        bench.map_cyclic();
        bench.nmt(NmtCommand::Start);
        for control in [0x06, 0x07, 0x0F] {
            bench.cycle(control, 0);
            bench.cycle(control, 0);
        }
        assert_eq!(bench.node.power_state(), PowerState::OperationEnabled);
        bench
    }

    /// Enabled, and at 100 counts a millisecond.
    fn moving() -> (Self, i32) {
        let mut bench = Self::enabled();
        let mut target = 0;
        for _ in 0..50 {
            target += 100;
            bench.cycle(0x0F, target);
        }
        bench.said.clear();
        (bench, target)
    }

    fn position(&self) -> f64 {
        self.node.demand(self.now).position_counts
    }

    fn emergencies(&self) -> Vec<u16> {
        let own = self.said.iter().filter(|(_, f)| f.id.raw() == 0x085);
        own.map(|(_, f)| u16::from_le_bytes([f.data()[0], f.data()[1]]))
            .collect()
    }

    fn said_by(&self, id: u16) -> Vec<(TimeNs, Frame)> {
        let own = self.said.iter().filter(|(_, f)| f.id.raw() == id);
        own.copied().collect()
    }
}
