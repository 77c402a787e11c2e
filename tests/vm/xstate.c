/* Lets User-Mode Linux run on CPUs whose extended registers are larger than it knows (AMX and what comes after).

   User-Mode Linux 6.1 runs each of its processes as a host process that it traces, and at every switch reads and writes
   that process's extended registers (x87, SSE, AVX, ...) with ptrace. It keeps 2696 bytes of them, which is all there
   was up to AVX-512 and protection keys. With AMX the host keeps 11008 bytes, and the host's kernel writes them only as
   a whole: the shorter write is refused with EFAULT, and User-Mode Linux panics at its first process ("ptrace set fp
   regs failed, errno = 14").

   linux.uml calls the C library's ptrace, so this library, preloaded, stands between the two. A read of part of the area
   returns that part; a write of part of the area becomes a write of the whole one in which every register that does not
   fit into the part is in its initial state. A program inside that used AMX would lose its tiles at the next switch;
   User-Mode Linux does not offer AMX to its programs. Every other request passes through unchanged.

   Layout of the area: Intel SDM volume 1, section 13.4 ("XSAVE area"), standard format; which component lies where is
   asked of the CPU (CPUID leaf 0DH), not assumed. */

#define _GNU_SOURCE
#include <cpuid.h>
#include <elf.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum {
    LARGEST = 65536, /* more than any CPU has; the kernel says how much of it there is */
    HEADER = 512,    /* where the area says which components it holds, one bit each */
    LEGACY = 3,      /* x87 and SSE: always present, always in front */
    FIRST_EXTENDED = 2,
    LAST_EXTENDED = 62,
    LEAF = 0xD,
    SUPERVISOR = 1, /* flag of a component that is the kernel's own and not in this area */
};

static char area[LARGEST] __attribute__((aligned(64)));

static long kernel(long request, long pid, void *address, void *data)
{
    return syscall(SYS_ptrace, request, pid, address, data);
}

/* Bytes of the whole area of that process; 0 if they cannot be read. The area is left in `area`. */
static size_t read_whole(long pid)
{
    struct iovec whole = {area, sizeof area};
    return kernel(PTRACE_GETREGSET, pid, (void *)NT_X86_XSTATE, &whole) < 0 ? 0 : whole.iov_len;
}

/* The components that lie within the first `length` bytes. */
static uint64_t components_within(size_t length)
{
    uint64_t components = LEGACY;
    for (int component = FIRST_EXTENDED; component <= LAST_EXTENDED; component++) {
        unsigned size, offset, flags, unused;
        if (__get_cpuid_count(LEAF, component, &size, &offset, &flags, &unused) && size
            && !(flags & SUPERVISOR) && offset + size <= length)
            components |= UINT64_C(1) << component;
    }
    return components;
}

static long read_part(long pid, struct iovec *part)
{
    size_t whole = read_whole(pid);
    if (whole == 0)
        return -1; /* errno is the kernel's */
    if (part->iov_len > whole)
        part->iov_len = whole;
    memcpy(part->iov_base, area, part->iov_len);
    return 0;
}

static long write_part(long pid, struct iovec *part)
{
    size_t whole = read_whole(pid);
    uint64_t held;
    if (part->iov_len >= whole || part->iov_len < HEADER + sizeof held)
        return kernel(PTRACE_SETREGSET, pid, (void *)NT_X86_XSTATE, part);
    memset(area, 0, whole);
    memcpy(area, part->iov_base, part->iov_len);
    memcpy(&held, area + HEADER, sizeof held);
    held &= components_within(part->iov_len);
    memcpy(area + HEADER, &held, sizeof held);
    struct iovec all = {area, whole};
    return kernel(PTRACE_SETREGSET, pid, (void *)NT_X86_XSTATE, &all);
}

long ptrace(enum __ptrace_request request, ...)
{
    va_list list;
    va_start(list, request);
    long pid = va_arg(list, pid_t);
    void *address = va_arg(list, void *);
    void *data = va_arg(list, void *);
    va_end(list);
    if (address == (void *)NT_X86_XSTATE && request == PTRACE_GETREGSET)
        return read_part(pid, data);
    if (address == (void *)NT_X86_XSTATE && request == PTRACE_SETREGSET)
        return write_part(pid, data);
    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
        long word; /* the C library returns the word, the kernel stores it */
        return kernel(request, pid, address, &word) < 0 ? -1 : word;
    }
    return kernel(request, pid, address, data);
}
