use super::*;
use trocar_canopen::cia301::sdo::Segment;

#[test]
fn values_are_written_and_read() {
    let mut bench = Bench::new();
    assert_eq!(bench.read(index::DEVICE_TYPE), 0x0002_0192);
    assert_eq!(bench.write(index::TARGET, &1234_i32.to_le_bytes()), Ok(()));
    assert_eq!(bench.read(index::TARGET), 1234);
    assert_eq!(
        bench.write(index::STATUS, &[0, 0]),
        Err(AbortCode::READ_ONLY)
    );
    assert_eq!(
        bench.write(Address::new(0x7777, 0), &[0]),
        Err(AbortCode::NO_OBJECT)
    );
    assert_eq!(bench.write(index::MODE, &[1]), Err(AbortCode::VALUE));
    assert_eq!(
        bench.write(Address::new(0x1010, 1), &[0; 4]),
        Err(AbortCode::CANNOT_STORE)
    );
    assert_eq!(bench.write(index::LIMIT_MIN, &9_i32.to_le_bytes()), Ok(()));
    assert_eq!(
        bench.write(index::LIMIT_MAX, &8_i32.to_le_bytes()),
        Err(AbortCode::MAX_BELOW_MIN)
    );
}

fn upload(bench: &mut Bench, address: Address) -> Vec<u8> {
    let begun = bench.request(Request::Upload(address));
    let Some(Response::Upload(_, Content::Segmented(Some(size)))) = begun else {
        panic!("{begun:?}");
    };
    let (mut all, mut toggle) = (Vec::new(), false);
    loop {
        let Some(Response::UploadSegment(segment)) = bench.request(Request::UploadSegment(toggle))
        else {
            panic!("no segment");
        };
        assert_eq!(segment.toggle(), toggle);
        all.extend_from_slice(segment.data());
        toggle = !toggle;
        if segment.is_last() {
            assert_eq!(all.len(), usize::try_from(size).unwrap());
            return all;
        }
    }
}

fn download(
    bench: &mut Bench,
    address: Address,
    size: Option<u32>,
    data: &[u8],
) -> Option<Response> {
    let begun = bench.request(Request::Download(address, Content::Segmented(size)));
    assert_eq!(begun, Some(Response::Download(address)));
    let (mut rest, mut toggle) = (data, false);
    loop {
        let segment = Segment::first_of(rest, toggle);
        let answer = bench.request(Request::DownloadSegment(segment));
        if segment.is_last() || answer != Some(Response::DownloadSegment(toggle)) {
            return answer;
        }
        rest = &rest[segment.data().len()..];
        toggle = !toggle;
    }
}

#[test]
fn texts_travel_in_segments() {
    let mut bench = Bench::new();
    assert_eq!(
        upload(&mut bench, Address::new(0x1008, 0)),
        b"Trocar emulated drive"
    );
    let label = b"the wrist's yaw, seven bytes each";
    let size = u32::try_from(label.len()).unwrap();
    let done = download(&mut bench, index::LABEL, Some(size), label);
    assert!(
        matches!(done, Some(Response::DownloadSegment(_))),
        "{done:?}"
    );
    assert_eq!(upload(&mut bench, index::LABEL), label);
    // A number may come in segments too.
    let done = download(&mut bench, index::TARGET, None, &77_i32.to_le_bytes());
    assert!(matches!(done, Some(Response::DownloadSegment(_))));
    assert_eq!(bench.read(index::TARGET), 77);
}

#[test]
fn broken_transfers_are_aborted_with_their_code() {
    let mut bench = Bench::new();
    let refused = |answer: Option<Response>| match answer {
        Some(Response::Abort(_, code)) => code,
        other => panic!("{other:?}"),
    };
    // Size that does not hold.
    let answer = download(&mut bench, index::LABEL, Some(3), b"abcd");
    assert_eq!(refused(answer), AbortCode::LENGTH);
    // More than the object holds.
    let answer = download(&mut bench, index::LABEL, None, &[b'x'; 70]);
    assert_eq!(refused(answer), AbortCode::TOO_LONG);
    // The same toggle bit twice.
    bench.request(Request::Upload(Address::new(0x1008, 0)));
    bench.request(Request::UploadSegment(false));
    let answer = bench.request(Request::UploadSegment(false));
    assert_eq!(refused(answer), AbortCode::TOGGLE);
    // A segment of nothing.
    let answer = bench.request(Request::UploadSegment(false));
    assert_eq!(refused(answer), AbortCode::COMMAND);
    // A block transfer.
    bench.said.clear();
    bench.frame(0x605, &[0xC2, 0x01, 0x20, 0, 4, 0, 0, 0]);
    let abort = Response::Abort(index::LABEL, AbortCode::COMMAND);
    assert_eq!(bench.said[0].1.payload, abort.emit());
}

#[test]
fn a_new_transfer_supersedes_and_a_forgotten_one_times_out() {
    let mut bench = Bench::new();
    bench.request(Request::Upload(Address::new(0x1008, 0)));
    assert_eq!(bench.read(index::DEVICE_TYPE), 0x0002_0192);
    let answer = bench.request(Request::UploadSegment(false));
    assert!(matches!(
        answer,
        Some(Response::Abort(_, AbortCode::COMMAND))
    ));
    bench.request(Request::Upload(Address::new(0x1008, 0)));
    bench.said.clear();
    bench.wait_ms(999);
    assert!(bench.said_by(0x585).is_empty());
    bench.wait_ms(3);
    let abort = Response::Abort(Address::new(0x1008, 0), AbortCode::TIMEOUT);
    assert_eq!(bench.said_by(0x585)[0].1.payload, abort.emit());
}

#[test]
fn a_stopped_node_has_no_dictionary() {
    let mut bench = Bench::new();
    bench.nmt(NmtCommand::Stop);
    assert_eq!(bench.request(Request::Upload(index::DEVICE_TYPE)), None);
    bench.nmt(NmtCommand::EnterPreOperational);
    assert_eq!(bench.read(index::DEVICE_TYPE), 0x0002_0192);
}

#[test]
fn stored_values_survive_a_reset_and_restored_ones_do_not() {
    let mut bench = Bench::new();
    let heartbeat = index::HEARTBEAT;
    bench.write(heartbeat, &[100, 0]).unwrap();
    bench.write(Address::new(0x1010, 1), b"save").unwrap();
    bench.write(heartbeat, &[50, 0]).unwrap();
    bench.nmt(NmtCommand::ResetNode);
    assert_eq!(bench.read(heartbeat), 100);
    bench.write(Address::new(0x1011, 1), b"load").unwrap();
    assert_eq!(bench.read(heartbeat), 100);
    bench.nmt(NmtCommand::ResetNode);
    assert_eq!(bench.read(heartbeat), 0);
}
