/* Counts a process's calls of MPI that could send something: preloaded, in front of MPI itself. */
#include <mpi.h>

static long calls = 0;
long mpi_calls(void) { return calls; }

#define COUNTED(name, given, passed) int MPI_##name given { calls++; return PMPI_##name passed; }

COUNTED(Allreduce, (const void *s, void *r, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c), (s, r, n, t, o, c))
COUNTED(Reduce, (const void *s, void *r, int n, MPI_Datatype t, MPI_Op o, int k, MPI_Comm c), (s, r, n, t, o, k, c))
COUNTED(Bcast, (void *b, int n, MPI_Datatype t, int k, MPI_Comm c), (b, n, t, k, c))
COUNTED(Barrier, (MPI_Comm c), (c))
COUNTED(Ibarrier, (MPI_Comm c, MPI_Request *q), (c, q))
COUNTED(Allgather, (const void *s, int n, MPI_Datatype t, void *r, int m, MPI_Datatype u, MPI_Comm c), (s, n, t, r, m, u, c))
COUNTED(Allgatherv, (const void *s, int n, MPI_Datatype t, void *r, const int m[], const int d[], MPI_Datatype u, MPI_Comm c), (s, n, t, r, m, d, u, c))
COUNTED(Gather, (const void *s, int n, MPI_Datatype t, void *r, int m, MPI_Datatype u, int k, MPI_Comm c), (s, n, t, r, m, u, k, c))
COUNTED(Gatherv, (const void *s, int n, MPI_Datatype t, void *r, const int m[], const int d[], MPI_Datatype u, int k, MPI_Comm c), (s, n, t, r, m, d, u, k, c))
COUNTED(Alltoall, (const void *s, int n, MPI_Datatype t, void *r, int m, MPI_Datatype u, MPI_Comm c), (s, n, t, r, m, u, c))
COUNTED(Send, (const void *b, int n, MPI_Datatype t, int k, int g, MPI_Comm c), (b, n, t, k, g, c))
COUNTED(Isend, (const void *b, int n, MPI_Datatype t, int k, int g, MPI_Comm c, MPI_Request *q), (b, n, t, k, g, c, q))
COUNTED(Recv, (void *b, int n, MPI_Datatype t, int k, int g, MPI_Comm c, MPI_Status *s), (b, n, t, k, g, c, s))
COUNTED(Irecv, (void *b, int n, MPI_Datatype t, int k, int g, MPI_Comm c, MPI_Request *q), (b, n, t, k, g, c, q))
COUNTED(Neighbor_alltoallv, (const void *s, const int n[], const int d[], MPI_Datatype t, void *r, const int m[], const int e[], MPI_Datatype u, MPI_Comm c), (s, n, d, t, r, m, e, u, c))
COUNTED(Ineighbor_alltoallv, (const void *s, const int n[], const int d[], MPI_Datatype t, void *r, const int m[], const int e[], MPI_Datatype u, MPI_Comm c, MPI_Request *q), (s, n, d, t, r, m, e, u, c, q))
