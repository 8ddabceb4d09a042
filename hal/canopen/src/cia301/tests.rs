use std::fmt::Debug;

use super::cob::PdoNumber;
use super::emcy::ErrorCode;
use super::pdo::{MappingEntry, PdoCob, Transmission};
use super::sdo::{Content, Expedited, Request, Response, Segment};
use super::sync::Sync;
use super::*;
use crate::arbitrary::Random;
use crate::{CanId, NodeId, Payload, WireError};

/// What parses must come back from its own bytes; what does not must say so without a panic.
fn returns<T: PartialEq + Debug>(
    data: &Payload,
    parse: impl Fn(&[u8]) -> Result<T, WireError>,
    emit: impl Fn(&T) -> Payload,
) -> bool {
    match parse(data.as_slice()) {
        Ok(value) => {
            let again = emit(&value);
            assert_eq!(parse(again.as_slice()).as_ref(), Ok(&value), "{data:?}");
            true
        }
        Err(_) => false,
    }
}

#[test]
fn arbitrary_bytes_parse_to_what_returns_or_to_an_error() {
    let mut random = Random::new(1);
    let node = NodeId::new(5).unwrap();
    let mut parsed = [0_u32; 6];
    for _ in 0..200_000 {
        let mut data = random.payload();
        if random.below(2) == 0 {
            data = Payload::truncated(&data.as_slice()[..usize::from(data.length()).min(2)]);
        }
        let nmt = |data: &[u8]| {
            let view = nmt::NmtView(data);
            Ok((view.command()?, view.target()?))
        };
        let outcomes = [
            returns(&data, Request::parse, |r| r.emit()),
            returns(&data, Response::parse, |r| r.emit()),
            returns(&data, Emergency::parse, |e| e.emit(node).payload),
            returns(&data, NmtState::parse, |s| s.emit(node).payload),
            returns(&data, Sync::parse, |s| s.emit(cob::SYNC_ID).payload),
            returns(&data, nmt, |(command, target)| {
                command.emit(*target).payload
            }),
        ];
        for (count, outcome) in parsed.iter_mut().zip(outcomes) {
            *count += u32::from(outcome);
        }
    }
    // Every codec has seen both.
    assert!(
        parsed.iter().all(|&count| count > 20 && count < 199_000),
        "{parsed:?}"
    );
}

#[test]
fn every_identifier_has_one_meaning() {
    for raw in 0..0x800 {
        let id = CanId::new(raw).unwrap();
        assert_eq!(Cob::of(id).id(), id);
    }
    let node = NodeId::new(5).unwrap();
    let second = PdoNumber::new(1).unwrap();
    assert_eq!(
        Cob::of(CanId::truncated(0x285)),
        Cob::TransmitPdo(second, node)
    );
    assert_eq!(
        Cob::of(CanId::truncated(0x205)),
        Cob::ReceivePdo(PdoNumber::new(0).unwrap(), node)
    );
    assert_eq!(Cob::of(CanId::truncated(0x085)), Cob::Emergency(node));
    assert_eq!(
        Cob::of(CanId::truncated(0x785)),
        Cob::Other(CanId::truncated(0x785))
    );
}

#[test]
fn sdo_frames_are_the_standards() {
    let address = Address::new(0x1017, 0);
    let write = |data: &[u8]| {
        let content = Content::Expedited(Expedited::new(data).unwrap());
        Request::Download(address, content).emit()
    };
    assert_eq!(
        write(&[1, 2, 3, 4]),
        Payload::full([0x23, 0x17, 0x10, 0, 1, 2, 3, 4])
    );
    assert_eq!(
        write(&[1, 2, 3]),
        Payload::full([0x27, 0x17, 0x10, 0, 1, 2, 3, 0])
    );
    assert_eq!(
        write(&[1, 2]),
        Payload::full([0x2B, 0x17, 0x10, 0, 1, 2, 0, 0])
    );
    assert_eq!(
        write(&[1]),
        Payload::full([0x2F, 0x17, 0x10, 0, 1, 0, 0, 0])
    );
    assert_eq!(
        Request::Upload(address).emit(),
        Payload::full([0x40, 0x17, 0x10, 0, 0, 0, 0, 0])
    );
    assert_eq!(
        Request::Download(address, Content::Segmented(Some(20))).emit(),
        Payload::full([0x21, 0x17, 0x10, 0, 20, 0, 0, 0])
    );
    let answer = |data: &[u8]| {
        Response::Upload(address, Content::Expedited(Expedited::new(data).unwrap())).emit()
    };
    assert_eq!(
        answer(&[7, 0]),
        Payload::full([0x4B, 0x17, 0x10, 0, 7, 0, 0, 0])
    );
    assert_eq!(
        Response::Download(address).emit(),
        Payload::full([0x60, 0x17, 0x10, 0, 0, 0, 0, 0])
    );
    assert_eq!(
        Response::DownloadSegment(true).emit(),
        Payload::full([0x30, 0, 0, 0, 0, 0, 0, 0])
    );
    assert_eq!(
        Request::UploadSegment(true).emit(),
        Payload::full([0x70, 0, 0, 0, 0, 0, 0, 0])
    );
    let last = Segment::first_of(b"abc", true);
    assert_eq!(
        Response::UploadSegment(last).emit(),
        Payload::full([0x19, b'a', b'b', b'c', 0, 0, 0, 0])
    );
    assert_eq!(
        Response::Abort(address, AbortCode::TOGGLE).emit(),
        Payload::full([0x80, 0x17, 0x10, 0, 0, 0, 3, 5])
    );
}

#[test]
fn block_transfers_and_short_frames_are_errors() {
    let block = [0xC2, 0, 0x10, 0, 0, 0, 0, 0];
    assert!(matches!(
        Request::parse(&block),
        Err(WireError::Value { value: 6, .. })
    ));
    assert_eq!(
        Request::parse(&block[..7]),
        Err(WireError::Length {
            expected: 8,
            found: 7
        })
    );
}

#[test]
fn pdo_parameters_return() {
    let mut random = Random::new(2);
    for _ in 0..20_000 {
        let [raw, ..] = [random.bits()];
        let raw = u32::try_from(raw & 0xFFFF_FFFF).unwrap();
        assert_eq!(MappingEntry::parse(raw).emit(), raw);
        // Mostly eleven bits, so that some parse.
        let raw = if random.below(4) > 0 {
            raw & 0xC000_07FF
        } else {
            raw
        };
        if let Ok(cob) = PdoCob::parse(raw) {
            assert_eq!(cob.emit(), raw);
        }
    }
    assert!(PdoCob::parse(0x2000_0185).is_err());
    for raw in 0..=255 {
        match Transmission::try_from(raw) {
            Ok(kind) => assert_eq!(kind.raw(), raw),
            Err(_) => assert!((241..=251).contains(&raw)),
        }
    }
}

#[test]
fn codes_have_texts() {
    assert_eq!(
        AbortCode::TOGGLE.to_string(),
        "0x05030000, toggle bit not alternated"
    );
    assert_eq!(
        AbortCode(1).to_string(),
        "0x00000001, a code of the device's own"
    );
    assert_eq!(ErrorCode::SYNC_CONTROLLER.text(), Some("SYNC lost"));
    assert_eq!(ErrorCode(0xFF01).text(), None);
}

#[test]
fn sync_counts_from_one_to_240() {
    assert!(Sync::counted(0).is_none() && Sync::counted(241).is_none());
    assert_eq!(Sync::parse(&[]), Ok(Sync::PLAIN));
    assert!(Sync::parse(&[0]).is_err() && Sync::parse(&[1, 2]).is_err());
    assert_eq!(Sync::parse(&[240]).map(Sync::counter), Ok(Some(240)));
}
