// Command forge-hook is the forge's hooks without the forge: it asks the running one over its internal API, as Gitea's own
// `gitea hook` does, but does not start all of Gitea for it, which costs 70 ms of processor time for each of the five hooks
// of a proposal that becomes main. Whatever goes wrong is a refusal.
//
//	forge-hook pre-receive|post-receive|proc-receive   (by git-receive-pack, in the repository)
//	forge-hook --version                               (the version of Gitea whose API it speaks)
//
// Besides, pre-receive takes a commit of break-glass (breakglass.go), about which the forge is not asked.
//
// FORGE_CONFIG names the forge's app.ini. The API is that of `modules/private` in Gitea's sources, the protocol of
// proc-receive that of githooks(5).
package main

import (
	"errors"
	"fmt"
	"io"
	"os"
	"os/exec"
	"strconv"
	"strings"
)

// version is Gitea's, written by the linker.
var version = "unknown"

const (
	configuration = "/etc/gitea/app.ini"
	batch         = 500 // references asked about at once
	master        = "refs/heads/master"
)

// hook is one run: what it reads and writes, and whom it asks.
type hook struct {
	in   io.Reader
	out  io.Writer
	talk io.Writer // what the person who pushes reads
	env  func(string) string
	api  *api
}

// change is a reference that is to move.
type change struct{ old, new, reference string }

func (c change) deletes() bool { return strings.Trim(c.new, "0") == "" }

func main() {
	if len(os.Args) == 2 && os.Args[1] == "--version" {
		fmt.Println("forge-hook for Gitea", version)
		return
	}
	if err := run(os.Args[1:]); err != nil {
		fmt.Fprintf(os.Stderr, "error:\nerror: %v\nerror:\n", err)
		os.Exit(1)
	}
}

func run(arguments []string) error {
	h := &hook{in: os.Stdin, out: os.Stdout, talk: os.Stderr, env: os.Getenv}
	kinds := map[string]func() error{
		"pre-receive": h.preReceive, "post-receive": h.postReceive, "proc-receive": h.procReceive,
	}
	if len(arguments) != 1 || kinds[arguments[0]] == nil {
		return errors.New("usage: forge-hook pre-receive|post-receive|proc-receive")
	}
	if arguments[0] == "post-receive" { // for clients that read the repository as plain files
		if answer, err := exec.Command("git", "update-server-info").CombinedOutput(); err != nil {
			return fmt.Errorf("git update-server-info: %w: %s", err, answer)
		}
	}
	if internal, _ := strconv.ParseBool(h.env("GITEA_INTERNAL_PUSH")); internal && arguments[0] != "proc-receive" {
		return nil // the forge's own push, which it has looked at
	}
	if h.env("SSH_ORIGINAL_COMMAND") == "" {
		return errors.New("this push did not come through the forge: nobody's rights can be looked up")
	}
	var err error
	if h.api, err = connect(h.env); err != nil {
		return err
	}
	return kinds[arguments[0]]()
}

// preReceive asks whether the pusher may move these references; break-glass is decided here.
func (h *hook) preReceive() error {
	if h.asksForGlass() {
		changes, err := h.changes()
		if err != nil {
			return err
		}
		return h.breakGlass(changes)
	}
	return h.batches(func(changes []change) error {
		return h.api.post("hook/pre-receive", h.options(changes, h.pushOptions()), nil)
	})
}

// postReceive tells the forge that they have moved, and the pusher what the forge says to that.
func (h *hook) postReceive() error {
	var first, empty bool
	var found []told
	err := h.batches(func(changes []change) error {
		for _, one := range changes {
			first = first || one.reference == master && !one.deletes()
		}
		var answer struct {
			Results      []told
			RepoWasEmpty bool
		}
		err := h.api.post("hook/post-receive", h.options(changes, h.pushOptions()), &answer)
		found, empty = append(found, answer.Results...), empty || answer.RepoWasEmpty
		return err
	})
	for _, one := range found {
		one.tell(h.talk)
	}
	if err == nil && empty && first {
		err = h.api.postTo("hook/set-default-branch", []string{"master"}, nil, nil)
	}
	return err
}

// told is what the forge has to say about a branch.
type told struct {
	Message, Create bool
	Branch, URL     string
}

func (t told) tell(to io.Writer) {
	if !t.Message {
		return
	}
	if t.Create {
		fmt.Fprintf(to, "\nCreate a new pull request for '%s':\n  %s\n\n", t.Branch, t.URL)
	} else {
		fmt.Fprintf(to, "\nVisit the existing pull request:\n  %s\n\n", t.URL)
	}
}

// changes reads all references that are to move.
func (h *hook) changes() ([]change, error) {
	text, err := io.ReadAll(h.in)
	if err != nil {
		return nil, fmt.Errorf("git's list of references: %w", err)
	}
	var found []change
	for line := range strings.Lines(string(text)) {
		one, ok := parse(strings.TrimSuffix(line, "\n"))
		if !ok {
			return nil, fmt.Errorf("git's list of references: %q is not `<old> <new> <reference>`", line)
		}
		found = append(found, one)
	}
	return found, nil
}

// batches hands all changes on in portions; those of a wiki concern nobody.
func (h *hook) batches(each func([]change) error) error {
	waiting, err := h.changes()
	if err != nil {
		return err
	}
	if wiki, _ := strconv.ParseBool(h.env("GITEA_REPO_IS_WIKI")); wiki {
		return nil
	}
	for len(waiting) > 0 {
		size := min(batch, len(waiting))
		if err := each(waiting[:size]); err != nil {
			return err
		}
		waiting = waiting[size:]
	}
	return nil
}

func parse(line string) (change, bool) {
	words := strings.SplitN(line, " ", 3)
	if len(words) != 3 {
		return change{}, false
	}
	return change{words[0], words[1], words[2]}, true
}

// pushOptions are those of the form key=value that git hands on in the environment.
func (h *hook) pushOptions() map[string]string {
	options := map[string]string{}
	count, _ := strconv.Atoi(h.env("GIT_PUSH_OPTION_COUNT"))
	for index := range count {
		if key, value, ok := strings.Cut(h.env("GIT_PUSH_OPTION_"+strconv.Itoa(index)), "="); ok {
			options[key] = value
		}
	}
	return options
}
