/* What compiled kernels call of numba's runtime: memory of arrays that live within one call, and ldexp. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#define ALIGNMENT 64

/* The head of a block of memory, as code of numba reads it: its users, how it is freed, where its data begins. */
typedef struct {
  size_t users;
  void *destructor, *destructor_info, *data;
  size_t size;
  void *allocator;
} Block;

static void *allocate(size_t size) {
  size_t head = sizeof(Block) + ALIGNMENT;
  Block *block = size <= SIZE_MAX - head ? malloc(head + size) : NULL;
  if (!block) return NULL;
  uintptr_t data = ((uintptr_t)(block + 1) + ALIGNMENT - 1) & ~(uintptr_t)(ALIGNMENT - 1);
  *block = (Block){1, NULL, NULL, (void *)data, size, NULL};
  return block;
}

void *NRT_MemInfo_alloc_safe_aligned(size_t size, unsigned alignment) {
  return alignment <= ALIGNMENT ? allocate(size) : NULL;
}
void *NRT_MemInfo_alloc_aligned(size_t size, unsigned alignment) {
  return NRT_MemInfo_alloc_safe_aligned(size, alignment);
}
void *NRT_MemInfo_alloc_safe(size_t size) { return allocate(size); }
void *NRT_MemInfo_alloc(size_t size) { return allocate(size); }
void NRT_MemInfo_call_dtor(Block *block) { free(block); }
double numba_ldexp(double x, int exponent) { return ldexp(x, exponent); }

/* Messages of errors are made by Python; a kernel only says that it failed. */
void *numba_unpickle(const char *data, int size, const char *hash) { abort(); }
int numba_gil_ensure(void *state) { abort(); }
