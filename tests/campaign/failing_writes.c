/* Lets an operation that writes below one folder fail, and those after it as such a disk would.
   Loaded with LD_PRELOAD; `fault_arm` and `fault_disarm` are called by ctypes. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static char below[PATH_MAX];
static long countdown;
static int number, armed, fired;

void fault_arm(const char *folder, long nth, int error) {
  snprintf(below, sizeof below, "%s", folder);
  countdown = nth, number = error, fired = 0, armed = 1;
}

/* Whether the fault has happened. */
int fault_disarm(void) {
  armed = 0;
  return fired;
}

/* A broken block fails once; on a full disk all further data fail, but names can be made and removed; on one that
   has become read-only everything fails. */
static int fails_at(const char *path, int data) {
  if (!armed || !path || strncmp(path, below, strlen(below))) return 0;
  if (!fired && --countdown > 0) return 0;
  if (fired && number != EROFS && (number == EIO || !data)) return 0;
  fired = 1, errno = number;
  return 1;
}

static int fails_with(int file, int data) {
  char link[64], path[PATH_MAX];
  if (!armed) return 0;
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  ssize_t length = readlink(link, path, sizeof path - 1);
  if (length < 0) return 0;
  path[length] = 0;
  return fails_at(path, data);
}

static int fails(int file) { return fails_with(file, 1); }

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define WRITES(flags) ((flags) & (O_WRONLY | O_RDWR | O_CREAT))

#define OPEN(name)                                            \
  int name(const char *path, int flags, ...) {                \
    va_list rest;                                             \
    va_start(rest, flags);                                    \
    mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(rest, mode_t) : 0; \
    va_end(rest);                                             \
    if (WRITES(flags) && fails_at(path, 0)) return -1;           \
    return NEXT(name)(path, flags, mode);                     \
  }
#define OPENAT(name)                                          \
  int name(int folder, const char *path, int flags, ...) {    \
    va_list rest;                                             \
    va_start(rest, flags);                                    \
    mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(rest, mode_t) : 0; \
    va_end(rest);                                             \
    if (WRITES(flags) && fails_at(path, 0)) return -1;           \
    return NEXT(name)(folder, path, flags, mode);             \
  }
OPEN(open)
OPEN(open64)
OPENAT(openat)
OPENAT(openat64)

#define FOPEN(name)                                           \
  FILE *name(const char *path, const char *mode) {            \
    if (strpbrk(mode, "wa+") && fails_at(path, 0)) return NULL;  \
    return NEXT(name)(path, mode);                            \
  }
FOPEN(fopen)
FOPEN(fopen64)

size_t fwrite(const void *data, size_t size, size_t count, FILE *stream) {
  if (stream != stdout && stream != stderr && fails(fileno(stream))) return 0;
  return NEXT(fwrite)(data, size, count, stream);
}

ssize_t write(int file, const void *data, size_t size) {
  return fails(file) ? -1 : NEXT(write)(file, data, size);
}
ssize_t pwrite(int file, const void *data, size_t size, off_t at) {
  return fails(file) ? -1 : NEXT(pwrite)(file, data, size, at);
}
ssize_t pwrite64(int file, const void *data, size_t size, off64_t at) {
  return fails(file) ? -1 : NEXT(pwrite64)(file, data, size, at);
}
ssize_t writev(int file, const struct iovec *parts, int count) {
  return fails(file) ? -1 : NEXT(writev)(file, parts, count);
}
ssize_t copy_file_range(int from, off64_t *at, int to, off64_t *where, size_t size, unsigned flags) {
  return fails(to) ? -1 : NEXT(copy_file_range)(from, at, to, where, size, flags);
}
ssize_t sendfile(int to, int from, off_t *at, size_t size) {
  return fails(to) ? -1 : NEXT(sendfile)(to, from, at, size);
}
ssize_t sendfile64(int to, int from, off64_t *at, size_t size) {
  return fails(to) ? -1 : NEXT(sendfile64)(to, from, at, size);
}
int fsync(int file) { return fails_with(file, 0) ? -1 : NEXT(fsync)(file); }
int ftruncate(int file, off_t size) { return fails(file) ? -1 : NEXT(ftruncate)(file, size); }
int ftruncate64(int file, off64_t size) { return fails(file) ? -1 : NEXT(ftruncate64)(file, size); }
int mkdir(const char *path, mode_t mode) { return fails_at(path, 0) ? -1 : NEXT(mkdir)(path, mode); }
int rename(const char *from, const char *to) { return fails_at(to, 0) ? -1 : NEXT(rename)(from, to); }
