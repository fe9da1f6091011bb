/* The two flash sectors that are kept for parameters. Erased bits are 1; programming makes them 0. */
#ifndef STM32F4_FLASH_MEMORY_H
#define STM32F4_FLASH_MEMORY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define FLASH_SECTORS 2u
#define FLASH_SECTOR_WORDS 32768u /* 128 KB */

/* The words of a sector, 0 or 1. */
const volatile uint32_t *flash_sector(unsigned sector);

/* Takes up to 2 s, and so long the core stands still: it runs from the same flash. */
void flash_erase(unsigned sector);

/* Programs words, at most 0.1 ms each; true when they then read as they should. */
bool flash_program(unsigned sector, size_t at, const uint32_t *words, size_t count);

#endif
