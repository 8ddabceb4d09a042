//! Logs with a bound on their size.

use super::*;

#[test]
fn a_log_with_a_bound_keeps_the_last_part() {
    let (records, header) = run_controller(30_000);
    let file = Scratch::new("bounded");
    let earlier = Scratch(crate::bound::earlier(&file.0));
    let bytes_max = 8 << 20;
    std::fs::write(&earlier.0, "of a run before").unwrap();
    let writing = Writing {
        bytes_max: Some(bytes_max),
        ..Writing::new(Pressure::Block)
    };
    let mut recorder = Recorder::create_with(&file.0, &header, writing).unwrap();
    for record in &records {
        if let Some(sequence) = record.arms.first.chunk_sequence {
            recorder.chunk(0, &chunk_of_run(sequence));
        }
        recorder.tick(record);
    }
    recorder.finish(Some(&outcome())).unwrap();
    let size = |file: &Scratch| std::fs::metadata(&file.0).unwrap().len();
    assert!(size(&file) + size(&earlier) <= bytes_max);
    let (last, before) = (
        RunLog::open(&file.0).unwrap(),
        RunLog::open(&earlier.0).unwrap(),
    );
    let tick = |log: &RunLog, last: bool| {
        let mut ticks = log.ticks().map(|(tick, _)| tick.tick);
        if last { ticks.last() } else { ticks.next() }.unwrap()
    };
    assert_eq!(tick(&last, true), 29_999);
    assert_eq!(tick(&last, false), tick(&before, true) + 1);
    assert_eq!(last.header.left_out, tick(&last, false));
    assert!(tick(&before, false) > 0, "the first file is still there");
    assert_eq!(last.outcome.as_ref().unwrap().reason, outcome().reason);
    // The first tick of a file has the period since the last one of the file before.
    for file in [&earlier, &file] {
        let periods = periods_ns(file);
        assert!(periods.iter().all(|ns| *ns == hal::TICK_NS), "{periods:?}");
    }
    for log in [&last, &before] {
        assert!(log.losses.is_empty() && !log.altered(), "{:?}", log.losses);
        assert!(
            log.cut()
                .unwrap()
                .starts_with("its bound left out the first")
        );
        let verified = crate::verify::verify(log).unwrap();
        assert!(verified.violations.is_empty(), "{:?}", verified.violations);
        assert!(!verified.ok && verified.bounded);
        let error = crate::replay::replay(log).unwrap_err().to_string();
        assert!(error.contains("nothing to replay"), "{error}");
    }
}

/// The periods that the messages of `/timing` in `file` hold, ns.
fn periods_ns(file: &Scratch) -> Vec<u64> {
    let bytes = std::fs::read(&file.0).unwrap();
    let messages = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap);
    let timing = messages.filter(|message| message.channel.topic == "/timing");
    let period = |message: mcap::Message<'_>| {
        let timing: crate::json::TimingMessage = serde_json::from_slice(&message.data).unwrap();
        timing.period_ns
    };
    timing.map(period).collect()
}

#[test]
fn the_first_part_of_a_log_is_no_whole_run() {
    let (records, header) = run_controller(6000);
    let file = Scratch::new("parts");
    let earlier = Scratch(crate::bound::earlier(&file.0));
    let size = |file: &Scratch| std::fs::metadata(&file.0).unwrap().len();
    let write = |bytes_max| {
        let writing = Writing {
            bytes_max,
            ..Writing::new(Pressure::Block)
        };
        let mut recorder = Recorder::create_with(&file.0, &header, writing).unwrap();
        for record in &records {
            if let Some(sequence) = record.arms.first.chunk_sequence {
                recorder.chunk(0, &chunk_of_run(sequence));
            }
            recorder.tick(record);
        }
        recorder.finish(Some(&outcome())).unwrap();
    };
    write(None);
    // Of two files one gets more than half of it, and so the other the rest.
    write(Some(size(&file) * 3 / 2 + 2 * crate::bound::SPARE_BYTES));
    let first = RunLog::open(&earlier.0).unwrap();
    assert_eq!(first.header.left_out, 0);
    assert!(
        first
            .cut()
            .unwrap()
            .starts_with("the run goes on in another file")
    );
    let verified = crate::verify::verify(&first).unwrap();
    assert!(
        !verified.ok && verified.violations.is_empty(),
        "{verified:?}"
    );
    let replayed = crate::replay::replay(&first).unwrap();
    assert_eq!(replayed.first_difference, None);
    assert!(!replayed.inputs_checked && replayed.ticks > 2000);
}
