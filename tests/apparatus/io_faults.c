/* Lets one call into the system fail: io_faults_arm(n, error) makes the n-th call from now on fail with that errno,
   or write only half for error -1. Calls on the first three descriptors are not counted. Loaded with LD_PRELOAD. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

static atomic_long left = 0, seen = 0;
static atomic_int armed = 0, fault = 0;

void io_faults_arm(long nth, int error) { seen = 0; left = nth; fault = error; armed = 1; }
long io_faults_disarm(void) { armed = 0; return seen; }

static int fails(void) {
    if (!armed) return 0;
    seen++;
    return --left == 0;
}
#define REAL(name) static __typeof__(name) *real; if (!real) real = (__typeof__(name) *)dlsym(RTLD_NEXT, #name)
#define FAIL if (fails() && fault > 0) { errno = fault; return -1; }

#define OPEN(name, ...) { mode_t mode = 0; \
    if (flags & (O_CREAT | O_TMPFILE)) { va_list rest; va_start(rest, flags); mode = va_arg(rest, mode_t); va_end(rest); } \
    REAL(name); FAIL return real(__VA_ARGS__, flags, mode); }
int open(const char *path, int flags, ...) OPEN(open, path)
int open64(const char *path, int flags, ...) OPEN(open64, path)
int openat(int folder, const char *path, int flags, ...) OPEN(openat, folder, path)
int openat64(int folder, const char *path, int flags, ...) OPEN(openat64, folder, path)

#define WRITE(name, ...) { REAL(name); \
    if (descriptor > 2 && fails()) { if (fault > 0) { errno = fault; return -1; } if (size > 1) size /= 2; } \
    return real(descriptor, data, size, ##__VA_ARGS__); }
ssize_t write(int descriptor, const void *data, size_t size) WRITE(write)
ssize_t pwrite(int descriptor, const void *data, size_t size, off_t at) WRITE(pwrite, at)
ssize_t pwrite64(int descriptor, const void *data, size_t size, off64_t at) WRITE(pwrite64, at)
ssize_t read(int descriptor, void *data, size_t size) { REAL(read); if (descriptor > 2) FAIL return real(descriptor, data, size); }
ssize_t pread(int descriptor, void *data, size_t size, off_t at) { REAL(pread); FAIL return real(descriptor, data, size, at); }
ssize_t pread64(int descriptor, void *data, size_t size, off64_t at) { REAL(pread64); FAIL return real(descriptor, data, size, at); }

int fsync(int descriptor) { REAL(fsync); FAIL return real(descriptor); }
int fdatasync(int descriptor) { REAL(fdatasync); FAIL return real(descriptor); }
int ftruncate(int descriptor, off_t size) { REAL(ftruncate); FAIL return real(descriptor, size); }
int ftruncate64(int descriptor, off64_t size) { REAL(ftruncate64); FAIL return real(descriptor, size); }
int rename(const char *from, const char *to) { REAL(rename); FAIL return real(from, to); }
int renameat(int a, const char *from, int b, const char *to) { REAL(renameat); FAIL return real(a, from, b, to); }
int mkdir(const char *path, mode_t mode) { REAL(mkdir); FAIL return real(path, mode); }
int mkdirat(int folder, const char *path, mode_t mode) { REAL(mkdirat); FAIL return real(folder, path, mode); }
int unlink(const char *path) { REAL(unlink); FAIL return real(path); }
int unlinkat(int folder, const char *path, int flags) { REAL(unlinkat); FAIL return real(folder, path, flags); }
int rmdir(const char *path) { REAL(rmdir); FAIL return real(path); }
int chmod(const char *path, mode_t mode) { REAL(chmod); FAIL return real(path, mode); }
int flock(int descriptor, int operation) { REAL(flock); FAIL return real(descriptor, operation); }
