//! Files that are cut off, damaged, or no logs.

use super::*;

#[test]
fn a_cut_file_is_readable_up_to_the_cut() {
    let (file, bytes) = write("cut", 600);
    let full = RunLog::from_bytes(&file.0, &bytes).unwrap();
    let mut best = 0;
    let mut unreadable = 0;
    for length in (0..bytes.len())
        .step_by(97)
        .chain(bytes.len() - 40..bytes.len())
    {
        match RunLog::from_bytes(&file.0, &bytes[..length]) {
            Ok(log) => {
                assert!(log.cut().is_some(), "{length} of {} bytes", bytes.len());
                for ((logged, _), tick) in log.ticks().zip(0..) {
                    assert_same(logged, &record(tick));
                }
                best = best.max(log.tick_count());
            }
            Err(LogError::NotOurs { .. }) => unreadable += 1,
            Err(other) => panic!("{length} bytes: {other}"),
        }
    }
    assert_eq!(best, full.tick_count());
    assert!(unreadable < 20, "{unreadable} cuts lost the header");
}

#[test]
fn a_file_cut_between_two_records_says_so() {
    let (file, bytes) = write("cut-between", 80);
    let reason = |length: usize| {
        let log = RunLog::from_bytes(&file.0, &bytes[..length]).unwrap();
        log.cut().unwrap().to_owned()
    };
    // The message of a cut inside a record tells where it begins.
    let inside = reason(bytes.len() / 2);
    let (_, begin) = inside.rsplit_once(' ').unwrap();
    assert!(
        inside.contains("inside the record that begins at"),
        "{inside}"
    );
    let begin = begin.parse().unwrap();
    assert_eq!(
        reason(begin),
        format!("the file ends at byte {begin}, before the end of the data")
    );
}

#[test]
fn only_a_file_that_was_read_is_bad_input() {
    let path = PathBuf::from("/nonexistent/a.mcap");
    assert!(RunLog::open(&path).unwrap_err().is_bad_input());
    let Err(error) = Recorder::create(&path, &header(), Pressure::Block) else {
        panic!("a folder that does not exist")
    };
    assert!(!error.is_bad_input(), "{error}");
    let reason = std::error::Error::source(&error).unwrap().to_string();
    assert!(!error.to_string().contains(&reason), "{error}");
}

#[test]
fn a_crash_loses_less_than_a_third_of_a_second() {
    let file = Scratch::new("crash");
    let mut recorder = Recorder::create(&file.0, &header(), Pressure::Block).unwrap();
    for tick in 0..1000 {
        recorder.tick(&record(tick));
    }
    let deadline = 20_000;
    let mut readable = 0;
    // The writer thread needs a moment; nothing is closed.
    for _ in 0..deadline {
        readable = RunLog::open(&file.0).map_or(0, |log| log.tick_count());
        if readable > 700 {
            break;
        }
        std::thread::yield_now();
    }
    assert!(readable > 700, "{readable} of 1000 ticks are in the file");
    recorder.finish(None).unwrap();
}

#[test]
fn any_flipped_bit_is_noticed() {
    let (file, bytes) = write("flip", 80);
    let (mut damaged, mut cut) = (0, 0);
    for index in (0..bytes.len()).step_by(11) {
        let mut bytes = bytes.clone();
        bytes[index] ^= 1 << (index % 8);
        match RunLog::from_bytes(&file.0, &bytes) {
            Ok(log) => {
                assert!(log.cut().is_some(), "bit in byte {index} went unnoticed");
                cut += 1;
            }
            Err(_) => damaged += 1,
        }
    }
    assert!(damaged > 10 * cut, "{damaged} damaged, {cut} cut");
}

#[test]
fn damage_names_the_place() {
    let (file, mut bytes) = write("place", 80);
    let middle = bytes.len() / 3;
    bytes[middle] ^= 4;
    let error = RunLog::from_bytes(&file.0, &bytes).unwrap_err();
    let LogError::Damaged { offset, .. } = error else {
        panic!("{error}")
    };
    assert!(
        offset < middle as u64
            && error
                .to_string()
                .contains(&format!("damaged at byte {offset}")),
        "{error}"
    );
}

#[test]
fn other_files_are_refused_with_a_reason() {
    let path = PathBuf::from("x.mcap");
    let text = RunLog::from_bytes(&path, b"PNG and so on").unwrap_err();
    assert!(matches!(text, LogError::NotMcap { .. }), "{text}");
    let empty = RunLog::from_bytes(&path, b"").unwrap_err();
    assert!(matches!(empty, LogError::NotOurs { .. }), "{empty}");
    let mut foreign = std::io::Cursor::new(Vec::new());
    mcap::Writer::new(&mut foreign).unwrap().finish().unwrap();
    let foreign = RunLog::from_bytes(&path, foreign.get_ref()).unwrap_err();
    assert!(
        foreign.to_string().contains("`run` is missing"),
        "{foreign}"
    );
    let absent = RunLog::open(&PathBuf::from("/nonexistent/a.mcap")).unwrap_err();
    assert!(matches!(absent, LogError::Read { .. }), "{absent}");
}
