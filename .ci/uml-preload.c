// A preload library that user-mode Linux 6.1 needs on today's machines.
//
// Registers: that kernel keeps 2696 bytes of its processes' XSAVE area. Where the processor has more (AMX: 11008 bytes), the host reads out the
// first part but refuses to write a part back (EFAULT), and the guest dies at its first process. Here the part is completed: what lies
// beyond it is marked as being in its initial state, which it is, since a process must ask the kernel for AMX and this guest's has none.
//
// Leftovers: if that kernel is killed, its helpers and its stopped processes stay behind for good; here they end with it.

#define _GNU_SOURCE
#include <cpuid.h>
#include <dlfcn.h>
#include <elf.h>
#include <errno.h>
#include <sched.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#define OLD_SETOPTIONS 21 // the first number of PTRACE_SETOPTIONS, which means the same

enum {
    LEGACY_AREA = 512,       // FXSAVE image; the bit map of saved components follows it
    HEADER_END = 512 + 64,
    AREA_MAX = 1 << 16,
};

static long raw_ptrace(long request, pid_t pid, void *address, void *data) {
    return syscall(SYS_ptrace, request, pid, address, data);
}

// The components of the standard XSAVE format that lie within the first `length` bytes.
static uint64_t components_within(size_t length) {
    uint64_t within = 3; // x87 and SSE: the legacy area
    for (unsigned component = 2; component < 63; component++) {
        unsigned size, offset, flags, unused;
        if (!__get_cpuid_count(0xd, component, &size, &offset, &flags, &unused)) break;
        if (size != 0 && (size_t)offset + size <= length) within |= 1ull << component;
    }
    return within;
}

static long write_completed(pid_t pid, const struct iovec *part) {
    static _Alignas(64) unsigned char area[AREA_MAX];
    static size_t area_size;
    static uint64_t within;
    if (area_size == 0) {
        struct iovec whole = {area, sizeof area};
        if (raw_ptrace(PTRACE_GETREGSET, pid, (void *)NT_X86_XSTATE, &whole) != 0) return -1;
        within = components_within(part->iov_len);
        area_size = whole.iov_len;
    }
    if (part->iov_len < HEADER_END || part->iov_len >= area_size) {
        errno = EFAULT;
        return -1;
    }
    memcpy(area, part->iov_base, part->iov_len);
    memset(area + part->iov_len, 0, area_size - part->iov_len);
    uint64_t saved;
    memcpy(&saved, area + LEGACY_AREA, sizeof saved);
    saved &= within;
    memcpy(area + LEGACY_AREA, &saved, sizeof saved);
    struct iovec whole = {area, area_size};
    return raw_ptrace(PTRACE_SETREGSET, pid, (void *)NT_X86_XSTATE, &whole);
}

long ptrace(enum __ptrace_request request, ...) {
    va_list arguments;
    va_start(arguments, request);
    pid_t pid = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);
    // PEEK requests are glibc's business alone: the system call returns their word through a pointer.
    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
        long word;
        long result = raw_ptrace(request, pid, address, &word);
        if (result == 0) errno = 0;
        return result == 0 ? word : result;
    }
    if (request == PTRACE_SETOPTIONS || (int)request == OLD_SETOPTIONS)
        data = (void *)((uintptr_t)data | PTRACE_O_EXITKILL);
    long result = raw_ptrace(request, pid, address, data);
    if (result != 0 && errno == EFAULT && request == PTRACE_SETREGSET && address == (void *)NT_X86_XSTATE)
        return write_completed(pid, data);
    return result;
}

// What a new thread or process runs, at the top of its own stack, which is there whether memory is shared or copied.
struct start {
    int (*function)(void *);
    void *argument;
};

static int start_mortal(void *given) {
    struct start *start = given;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    return start->function(start->argument);
}

// User-mode Linux gives no more than these four arguments.
int clone(int (*function)(void *), void *stack, int flags, void *argument, ...) {
    static int (*next)(int (*)(void *), void *, int, void *, ...);
    if (next == NULL) next = (int (*)(int (*)(void *), void *, int, void *, ...))dlsym(RTLD_NEXT, "clone");
    struct start *start = (struct start *)((uintptr_t)stack & ~(uintptr_t)15) - 1;
    *start = (struct start){function, argument};
    return next(start_mortal, start, flags, start);
}
