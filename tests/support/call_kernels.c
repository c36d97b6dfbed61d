/* Calls kernels of a library as a file describes the calls, and writes what they have written: on a processor that
   an emulator plays. See scripts/test-arm. */
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

static uint64_t number(FILE *file) {
  uint64_t value;
  if (fread(&value, sizeof value, 1, file) != 1) exit(feof(file) ? 0 : 1);
  return value;
}

static char *bytes(FILE *file, uint64_t size) {
  char *data = aligned_alloc(64, (size + 127) & ~(uint64_t)63);
  if (!data || (size && fread(data, size, 1, file) != 1)) exit(2);
  return data;
}

int main(int count, char **names) {
  void *library = count == 4 ? dlopen(names[1], RTLD_NOW) : NULL;
  FILE *calls = library ? fopen(names[2], "rb") : NULL;
  FILE *results = calls ? fopen(names[3], "wb") : NULL;
  if (!results) {
    fprintf(stderr, "expected LIBRARY CALLS RESULTS, got %d files; %s\n", count - 1, library ? "" : dlerror());
    return 3;
  }
  for (;;) {
    char *name = bytes(calls, number(calls));
    uint64_t buffer_size = number(calls);
    char *buffer = bytes(calls, buffer_size);
    uint64_t arrays_size = number(calls);
    char *arrays = bytes(calls, arrays_size);
    uint64_t pointers = number(calls);
    int (*kernel)(void *) = (int (*)(void *))dlsym(library, name);
    int64_t status;
    if (!kernel) return 4;
    for (uint64_t i = 0; i < pointers; i++) {
      uint64_t at = number(calls);
      *(uint64_t *)(buffer + at) = (uint64_t)(uintptr_t)(arrays + number(calls));
    }
    status = kernel(buffer);
    fwrite(&status, sizeof status, 1, results);
    fwrite(buffer, buffer_size, 1, results);
    fwrite(arrays, arrays_size, 1, results);
    fflush(results);
    free(name), free(buffer), free(arrays);
  }
}
