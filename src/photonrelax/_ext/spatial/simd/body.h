/* The loops of kernels.h for one instruction set: VECTOR of WIDTH doubles, F_VECTOR of F_WIDTH
 * floats, and what is done to them.
 *
 * Loops work on eight doubles, V8, or sixteen floats, F16, however many vectors that takes, and add
 * up in one order, so that all instruction sets give the same bits.
 */
#include "vector.h"

#include "search.h"

#include "gather.h"

static const SimdKernels NAME(lanes) = {
    SET_NAME, NAME(boxes_near), NAME(copies_near), NAME(list_boxes), NAME(copy_rows),
    NAME(copy_blocks),
    NAME(scan), NAME(scan_copies), NAME(rescan), NAME(nearest), NAME(compact),
    NAME(list), NAME(list_points), NAME(sort), NAME(write),
    NAME(moments), NAME(repulsion), NAME(weigh),
};

#undef V8
#undef M8
#undef PARTS
#undef SET_SUFFIX
#undef SET_NAME
#undef TARGET
#undef WIDTH
#undef VECTOR
#undef MASK
#undef SET
#undef LOAD
#undef STORE
#undef STREAM
#undef ADD
#undef SUB
#undef MUL
#undef DIV
#undef MAX
#undef MIN
#undef SQRT
#undef TOTAL
#undef AT_MOST
#undef BOTH
#undef BITS
#undef PICK
#undef CHOOSE
#undef PACK
#undef F16
#undef FM16
#undef F_PARTS
#undef F_WIDTH
#undef F_VECTOR
#undef F_MASK
#undef F_SET
#undef F_LOAD
#undef F_STORE
#undef F_STORE_INTEGERS
#undef F_ADD
#undef F_SUB
#undef F_MUL
#undef F_MAX
#undef F_MIN
#undef F_AT_MOST
#undef F_BOTH
#undef F_BITS
#undef F_PICK
#undef F_ADD_WHERE
#undef STORE_ROUNDED
