package main

import (
	"fmt"
	"runtime"
	"unsafe"

	"golang.org/x/sys/unix"
)

const (
	loadWord         = unix.BPF_LD | unix.BPF_W | unix.BPF_ABS
	jumpEqual        = unix.BPF_JMP | unix.BPF_JEQ | unix.BPF_K
	jumpGreaterEqual = unix.BPF_JMP | unix.BPF_JGE | unix.BPF_K
	giveBack         = unix.BPF_RET | unix.BPF_K
	allow            = 0x7fff0000
	refuse           = 0x00050000 | uint32(unix.EPERM)
	setFilter        = 1          // SECCOMP_SET_MODE_FILTER
	allThreads       = 1          // SECCOMP_FILTER_FLAG_TSYNC
	foreignNumbers   = 0x40000000 // x32 on x86-64
)

// refused are calls that open something outside of this process: files, sockets, programs, other processes.
var refused = append([]uint32{
	unix.SYS_OPENAT, unix.SYS_OPENAT2, unix.SYS_OPEN_BY_HANDLE_AT, unix.SYS_SOCKET, unix.SYS_SOCKETPAIR, unix.SYS_CONNECT,
	unix.SYS_EXECVE, unix.SYS_EXECVEAT, unix.SYS_IO_URING_SETUP, unix.SYS_PTRACE, unix.SYS_PROCESS_VM_READV,
	unix.SYS_PROCESS_VM_WRITEV, unix.SYS_PIDFD_GETFD, unix.SYS_KILL, unix.SYS_LINKAT, unix.SYS_SYMLINKAT, unix.SYS_UNLINKAT,
	unix.SYS_RENAMEAT2, unix.SYS_MKDIRAT, unix.SYS_MKNODAT, unix.SYS_FCHMODAT, unix.SYS_FCHOWNAT, unix.SYS_MOUNT,
	unix.SYS_UNSHARE, unix.SYS_SETNS,
}, olderCalls...)

// confine takes from all threads, for good, the calls in `refused`, and calls in any foreign form.
func confine() error {
	filter := []unix.SockFilter{
		{Code: loadWord, K: 4}, // the architecture
		{Code: jumpEqual, Jt: 1, K: architecture},
		{Code: giveBack, K: refuse},
		{Code: loadWord, K: 0}, // the number of the call
		{Code: jumpGreaterEqual, Jf: 1, K: foreignNumbers},
		{Code: giveBack, K: refuse},
	}
	for _, number := range refused {
		filter = append(filter, unix.SockFilter{Code: jumpEqual, Jf: 1, K: number}, unix.SockFilter{Code: giveBack, K: refuse})
	}
	filter = append(filter, unix.SockFilter{Code: giveBack, K: allow})
	program := unix.SockFprog{Len: uint16(len(filter)), Filter: &filter[0]}
	if err := unix.Prctl(unix.PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0); err != nil {
		return fmt.Errorf("no new privileges: %w", err)
	}
	thread, _, fault := unix.Syscall(unix.SYS_SECCOMP, setFilter, allThreads, uintptr(unsafe.Pointer(&program)))
	runtime.KeepAlive(filter)
	if fault != 0 {
		return fmt.Errorf("the kernel refused the filter: %w", fault)
	}
	if thread != 0 {
		return fmt.Errorf("the filter does not hold for thread %d", thread)
	}
	return nil
}
