package main

import (
	"bytes"
	"errors"
	"fmt"
	"io"
	"strconv"
	"strings"
)

const (
	protocol = "version=1"
	packet   = 65520 // the longest packet, its length included
)

// proposed is what the forge made of a push to refs/for/<branch>.
type proposed struct {
	OldOID, NewOID, Ref, OriginalRef, Err, URL, HeadBranch   string
	IsForcePush, IsNotMatched, IsCreatePR, ShouldShowMessage bool
}

// procReceive lets the forge make pull requests of what was pushed.
func (h *hook) procReceive() error {
	withOptions, err := h.agree()
	if err != nil {
		return err
	}
	lines, err := packets(h.in)
	if err != nil {
		return err
	}
	var changes []change
	for _, line := range lines {
		found, ok := parse(line)
		if !ok {
			return fmt.Errorf("git's list of references: %q is not `<old> <new> <reference>`", line)
		}
		changes = append(changes, found)
	}
	given := map[string]string{}
	if withOptions {
		if lines, err = packets(h.in); err != nil {
			return err
		}
		for _, line := range lines {
			key, value, _ := strings.Cut(line, "=")
			given[key] = value
		}
	}
	var answer struct{ Results []proposed }
	if err := h.api.post("hook/proc-receive", h.options(changes, given), &answer); err != nil {
		return err
	}
	return h.report(answer.Results)
}

// agree settles version and abilities with git: whether push options follow.
func (h *hook) agree() (bool, error) {
	lines, err := packets(h.in)
	if err != nil {
		return false, err
	}
	if len(lines) != 1 {
		return false, errors.New("git's greeting is not one line")
	}
	offered, abilities, _ := strings.Cut(lines[0], "\x00")
	if strings.TrimSuffix(offered, "\n") != protocol {
		return false, fmt.Errorf("git speaks %q, this hook %s", offered, protocol)
	}
	reply, withOptions := protocol, false
	for _, ability := range strings.Fields(abilities) {
		withOptions = withOptions || ability == "push-options"
	}
	if withOptions {
		reply += "\x00push-options"
	}
	return withOptions, h.send(reply + "\n")
}

// report tells git what became of each reference, and the pusher where the pull requests are.
func (h *hook) report(results []proposed) error {
	var lines []string
	for _, one := range results {
		switch {
		case one.Err != "":
			lines = append(lines, "ng "+one.OriginalRef+" "+one.Err)
		case one.IsNotMatched:
			lines = append(lines, "ok "+one.OriginalRef, "option fall-through")
		default:
			lines = append(lines, "ok "+one.OriginalRef, "option refname "+one.Ref)
			if strings.Trim(one.OldOID, "0") != "" {
				lines = append(lines, "option old-oid "+one.OldOID)
			}
			lines = append(lines, "option new-oid "+one.NewOID)
			if one.IsForcePush {
				lines = append(lines, "option forced-update")
			}
		}
	}
	if err := h.send(lines...); err != nil {
		return err
	}
	for _, one := range results {
		told{one.ShouldShowMessage, one.IsCreatePR, one.HeadBranch, one.URL}.tell(h.talk)
	}
	return nil
}

// send writes the lines as packets, and the empty one that ends them.
func (h *hook) send(lines ...string) error {
	var out bytes.Buffer
	for _, line := range lines {
		if len(line)+4 > packet {
			return fmt.Errorf("an answer of %d bytes fits into no packet", len(line))
		}
		fmt.Fprintf(&out, "%04x%s", len(line)+4, line)
	}
	out.WriteString("0000")
	_, err := h.out.Write(out.Bytes())
	return err
}

// packets reads up to the empty packet.
func packets(in io.Reader) ([]string, error) {
	var found []string
	for {
		head := make([]byte, 4)
		if _, err := io.ReadFull(in, head); err != nil {
			return nil, fmt.Errorf("git ended in the middle: %w", err)
		}
		size, err := strconv.ParseUint(string(head), 16, 16)
		switch {
		case err != nil || size > packet || size > 0 && size <= 4:
			return nil, fmt.Errorf("git sent a packet of length %q", head)
		case size == 0:
			return found, nil
		}
		body := make([]byte, size-4)
		if _, err := io.ReadFull(in, body); err != nil {
			return nil, fmt.Errorf("git ended in the middle: %w", err)
		}
		found = append(found, string(body))
	}
}
