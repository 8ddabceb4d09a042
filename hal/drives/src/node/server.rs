//! The server of the object dictionary: expedited and segmented transfers, one at a time.
//!
//! CiA 301, section 7.2.4.
//!
//! Answers go out with the request, under 580h plus the node's number; the client's are under 600h
//! plus it. Among the aborts that a client may meet are 0503 0000h toggle bit, 0504 0000h time-out,
//! 0504 0001h unknown command, 0602 0000h no object, 0607 0010h length, and those of `rules`. Block
//! transfers are refused as an unknown command.

use super::{Node, Outbox};
use hal::TimeNs;
use hal::count::count_u32;
use trocar_canopen::Frame;
use trocar_canopen::bytes::Bytes;
use trocar_canopen::cia301::sdo::{Content, Expedited, Request, Response, SdoView, Segment};
use trocar_canopen::cia301::{AbortCode, Address, Cob};
use trocar_canopen::index;

/// How long a client may think between two segments, ns.
const TIMEOUT_NS: u64 = 1_000_000_000;

/// The transfer under way. A new one supersedes it.
///
/// Only texts are longer than the four bytes of an expedited transfer; a client may send others in
/// segments, too.
#[derive(Clone, Copy, Debug)]
pub(super) enum Transfer {
    /// None.
    Idle,
    /// The client reads.
    Upload {
        /// Of the object that is read.
        address: Address,
        /// A copy as it was at the request: what changes later is not mixed in.
        data: Bytes,
        /// Bytes sent up to now.
        sent: usize,
        toggle: bool,
        /// When the newest segment came; the time-out counts from here.
        since: TimeNs,
    },
    /// The client writes.
    Download {
        address: Address,
        data: Bytes,
        /// As announced; none if the client left it open.
        size: Option<u32>,
        toggle: bool,
        since: TimeNs,
    },
}

impl Node {
    /// An SDO request for this node. One transfer at a time; a new one ends the last.
    ///
    /// A request of another length than eight bytes has no answer.
    pub(super) fn on_sdo(&mut self, now: TimeNs, data: &[u8], out: &mut Outbox) {
        let view = SdoView(data);
        let answer = match Request::parse(data) {
            Ok(request) => self.answer(now, request, out),
            Err(_) => match view.address() {
                // Not of eight bytes: there is no address to answer with.
                Err(_) => return,
                Ok(address) => {
                    self.transfer = Transfer::Idle;
                    Some(Response::Abort(address, AbortCode::COMMAND))
                }
            },
        };
        if let Some(answer) = answer {
            self.respond(answer, out);
        }
    }

    /// Sends a response.
    fn respond(&self, response: Response, out: &mut Outbox) {
        let id = Cob::SdoResponse(self.id).id();
        out.push(Frame::new(id, response.emit()));
    }

    /// The response to `request`; none to an abort.
    fn answer(&mut self, now: TimeNs, request: Request, out: &mut Outbox) -> Option<Response> {
        match request {
            Request::Abort(..) => {
                self.transfer = Transfer::Idle;
                None
            }
            Request::Upload(address) => Some(self.begin_upload(now, address)),
            Request::UploadSegment(toggle) => Some(self.upload_segment(now, toggle)),
            Request::Download(address, content) => {
                Some(self.begin_download(now, address, content, out))
            }
            Request::DownloadSegment(segment) => Some(self.download_segment(now, &segment, out)),
        }
    }

    /// Up to four bytes at once, more in segments.
    ///
    /// A value of up to four bytes is in the answer itself, a longer one is announced with its
    /// size.
    fn begin_upload(&mut self, now: TimeNs, address: Address) -> Response {
        self.transfer = Transfer::Idle;
        let read = match self.dictionary.read(address) {
            Ok(_) if self.is_no_error_yet(address) => Err(AbortCode::NO_DATA),
            other => other,
        };
        let data = match read {
            Ok(data) => data,
            Err(code) => return Response::Abort(address, code),
        };
        if let Some(short) = Expedited::new(data.as_slice()) {
            return Response::Upload(address, Content::Expedited(short));
        }
        let size = count_u32(data.as_slice().len());
        self.transfer = Transfer::Upload {
            address,
            data,
            sent: 0,
            toggle: false,
            since: now,
        };
        Response::Upload(address, Content::Segmented(Some(size)))
    }

    /// Whether `address` is an entry of the error history (1003h) that is empty.
    fn is_no_error_yet(&self, address: Address) -> bool {
        let errors = index::ERROR_COUNT;
        address.index == errors.index && i64::from(address.sub) > self.dictionary.get(errors)
    }

    /// The next segment; its toggle bit must alternate.
    fn upload_segment(&mut self, now: TimeNs, toggle: bool) -> Response {
        let Transfer::Upload {
            address,
            data,
            sent,
            toggle: expected,
            ..
        } = self.transfer
        else {
            return self.abort(AbortCode::COMMAND);
        };
        if toggle != expected {
            return self.abort(AbortCode::TOGGLE);
        }
        let segment = Segment::first_of(&data.as_slice()[sent..], toggle);
        self.transfer = if segment.is_last() {
            Transfer::Idle
        } else {
            Transfer::Upload {
                address,
                data,
                sent: sent + segment.data().len(),
                toggle: !toggle,
                since: now,
            }
        };
        Response::UploadSegment(segment)
    }

    /// Stores an expedited value. Without a size, all four bytes came and the object says how many
    /// it wants.
    fn download_expedited(
        &mut self,
        now: TimeNs,
        address: Address,
        data: Expedited,
        out: &mut Outbox,
    ) -> Response {
        let own = self.dictionary.read(address);
        let length = own.map_or(4, |own| own.as_slice().len());
        let data = match data.data() {
            all if data.is_sized() => all,
            all => &all[..length.min(all.len())],
        };
        match self.store(now, address, data, out) {
            Ok(()) => Response::Download(address),
            Err(code) => Response::Abort(address, code),
        }
    }

    /// Stores an expedited value, or waits for the segments of a longer one.
    fn begin_download(
        &mut self,
        now: TimeNs,
        address: Address,
        content: Content,
        out: &mut Outbox,
    ) -> Response {
        self.transfer = Transfer::Idle;
        match content {
            Content::Expedited(data) => self.download_expedited(now, address, data, out),
            Content::Segmented(size) => {
                self.transfer = Transfer::Download {
                    address,
                    data: Bytes::truncated(&[]),
                    size,
                    toggle: false,
                    since: now,
                };
                Response::Download(address)
            }
        }
    }

    /// Collects a segment; the last one stores the value if its size is the announced one.
    fn download_segment(&mut self, now: TimeNs, segment: &Segment, out: &mut Outbox) -> Response {
        let Transfer::Download {
            address,
            mut data,
            size,
            toggle,
            ..
        } = self.transfer
        else {
            return self.abort(AbortCode::COMMAND);
        };
        if segment.toggle() != toggle {
            return self.abort(AbortCode::TOGGLE);
        }
        if !data.extend(segment.data()) {
            return self.abort(AbortCode::TOO_LONG);
        }
        self.transfer = Transfer::Download {
            address,
            data,
            size,
            toggle: !toggle,
            since: now,
        };
        if !segment.is_last() {
            return Response::DownloadSegment(toggle);
        }
        if size.is_some_and(|size| usize::try_from(size) != Ok(data.as_slice().len())) {
            return self.abort(AbortCode::LENGTH);
        }
        match self.store(now, address, data.as_slice(), out) {
            Ok(()) => {
                self.transfer = Transfer::Idle;
                Response::DownloadSegment(toggle)
            }
            Err(code) => self.abort(code),
        }
    }

    /// Ends the transfer with `code`.
    ///
    /// Names the object of the transfer, or 0000h:00 without one.
    fn abort(&mut self, code: AbortCode) -> Response {
        let address = match self.transfer {
            Transfer::Idle => Address::new(0, 0),
            Transfer::Upload { address, .. } | Transfer::Download { address, .. } => address,
        };
        self.transfer = Transfer::Idle;
        Response::Abort(address, code)
    }

    /// Aborts a transfer after the client's time-out.
    pub(super) fn server_timeout(&mut self, now: TimeNs, out: &mut Outbox) {
        let since = match self.transfer {
            Transfer::Idle => return,
            Transfer::Upload { since, .. } | Transfer::Download { since, .. } => since,
        };
        if now.since(since) > TIMEOUT_NS {
            let abort = self.abort(AbortCode::TIMEOUT);
            self.respond(abort, out);
        }
    }
}
