/* Saved states of an instance: copies in memory, and the same as bytes for a file or another process.
 *
 * What FMI 2.0 section 2.1.8 and FMI 3.0 call the FMU state. A copy is a plant_snapshot behind a pointer that
 * the importer keeps; restored, it continues with the same bits. The functions that return bool fail as those
 * of instance.h do. */
#ifndef PLANT_SAVED_STATE_H
#define PLANT_SAVED_STATE_H

#include "hidden.h"
#include "instance.h"

HIDDEN_BEGIN

/* Copies the instance's state to `*state`, which is allocated when it is NULL. */
bool plant_save(plant_instance *plant, void **state);
bool plant_restore(plant_instance *plant, const void *state);

/* Frees `*state` and makes it NULL. */
void plant_forget(void **state);

/* Bytes: the model's GUID, the snapshot as this machine lays it out, and a checksum. */
size_t plant_serialized_size(void);
bool plant_serialize(plant_instance *plant, const void *state, void *bytes, size_t size);
bool plant_deserialize(plant_instance *plant, const void *bytes, size_t size, void **state);

HIDDEN_END

#endif
