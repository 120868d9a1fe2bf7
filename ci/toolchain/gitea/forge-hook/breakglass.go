package main

import (
	"bytes"
	"crypto/ed25519"
	"crypto/sha512"
	"encoding/base64"
	"encoding/binary"
	"errors"
	"fmt"
	"io"
	"os/exec"
	"strconv"
	"strings"
	"time"
)

// Break-glass: while the gate is away, main takes one commit that two registered people have signed. What they sign is a
// statement about exactly this commit on exactly this tip of this repository at this time, so it can neither be replayed
// nor moved. Who is registered stands on main, in a file that such a commit may not change. The commit carries the
// signatures, so that it is recognised later from Git alone. The form is that of
// robotkube.delivery.deployment.core.break_glass.
const (
	mainBranch      = "refs/heads/main"
	glassOption     = "break-glass"
	glassTrailer    = "RobotKube-Break-Glass: "
	signedTrailer   = "RobotKube-Signed-By: "
	signersFile     = "policies/signers"
	acceptedFile    = "policies/accepted-commits"
	signatureOf     = "robotkube-break-glass"
	signersMin      = 2
	signersMax      = 10
	ageMax          = 15 * time.Minute
	aheadMax        = time.Minute // clocks differ
	objectBytesMax  = 64 * 1024
	timeForm        = "2006-01-02T15:04:05Z"
	ed25519Name     = "ssh-ed25519"
	sshsigMagic     = "SSHSIG"
	sshsigVersion   = 1
	signatureDigest = "sha512"
)

// asksForGlass says whether the pusher asked for break-glass, with the push option of that name.
func (h *hook) asksForGlass() bool {
	count, _ := strconv.Atoi(h.env("GIT_PUSH_OPTION_COUNT"))
	for index := range count {
		if h.env("GIT_PUSH_OPTION_"+strconv.Itoa(index)) == glassOption {
			return true
		}
	}
	return false
}

// breakGlass returns nil when the push is one commit on main that two registered people have signed just now.
func (h *hook) breakGlass(changes []change) error {
	if err := h.glass(changes); err != nil {
		return fmt.Errorf("break-glass: %w", err)
	}
	fmt.Fprintln(h.talk, "break-glass: main takes this commit without the gate; it stands out until a checked commit has replaced it")
	return nil
}

func (h *hook) glass(changes []change) error {
	wiki, _ := strconv.ParseBool(h.env("GITEA_REPO_IS_WIKI"))
	if wiki || len(changes) != 1 || changes[0].reference != mainBranch {
		return fmt.Errorf("push %s and nothing else", mainBranch)
	}
	moved := changes[0]
	if strings.Trim(moved.old, "0") == "" || moved.deletes() {
		return errors.New("main is neither made nor deleted in this way")
	}
	registered, err := readSigners(moved.old)
	if err != nil {
		return err
	}
	if len(registered) < signersMin {
		return fmt.Errorf("%s on main names fewer than %d people: break-glass is off", signersFile, signersMin)
	}
	if pusher := h.env("GITEA_PUSHER_NAME"); len(registered[pusher]) == 0 {
		return fmt.Errorf("%q is none of the people in %s on main", pusher, signersFile)
	}
	text, err := object("commit", moved.new)
	if err != nil {
		return err
	}
	commit, err := parseCommit(text)
	if err != nil {
		return err
	}
	if len(commit.parents) != 1 || commit.parents[0] != moved.old {
		return fmt.Errorf("the commit's only parent must be main's tip %.12s; sign one that stands on it", moved.old)
	}
	repository := strings.ToLower(h.env("GITEA_REPO_USER_NAME") + "/" + h.env("GITEA_REPO_NAME"))
	if err := commit.signed(repository, registered, time.Now()); err != nil {
		return err
	}
	for _, path := range []string{signersFile, acceptedFile} {
		if !same(moved.old, moved.new, path) {
			return fmt.Errorf("%s is changed by the gate alone; leave it out", path)
		}
	}
	return nil
}

// signers are the keys of each registered person.
type signers map[string][]ed25519.PublicKey

// readSigners reads the registered people from a commit; a file that is not there names nobody.
func readSigners(commit string) (signers, error) {
	if _, err := git("cat-file", "-e", commit+":"+signersFile); err != nil {
		return signers{}, nil
	}
	text, err := object("blob", commit+":"+signersFile)
	if err != nil {
		return nil, err
	}
	found := signers{}
	seen := map[string]bool{}
	for number, line := range strings.Split(string(text), "\n") {
		words := strings.Fields(line)
		if len(words) == 0 || strings.HasPrefix(words[0], "#") {
			continue
		}
		if len(words) < 3 || words[1] != ed25519Name {
			return nil, fmt.Errorf("%s on main, line %d: must be `<name> %s <key>`", signersFile, number+1, ed25519Name)
		}
		key, err := publicKey(words[2])
		if err == nil && seen[string(key)] {
			err = errors.New("stands there twice")
		}
		if err != nil {
			return nil, fmt.Errorf("%s on main, line %d: key: %w", signersFile, number+1, err)
		}
		seen[string(key)] = true
		found[words[0]] = append(found[words[0]], key)
	}
	return found, nil
}

// publicKey reads the key of an OpenSSH public key line.
func publicKey(text string) (ed25519.PublicKey, error) {
	data, err := base64.StdEncoding.DecodeString(text)
	if err != nil {
		return nil, err
	}
	read := &fields{data: data}
	name, key := read.next(), read.next()
	if !read.done() || string(name) != ed25519Name || len(key) != ed25519.PublicKeySize {
		return nil, errors.New("no ed25519 key")
	}
	return key, nil
}

// written is a commit as far as it is signed.
type written struct {
	tree    string
	parents []string
	message string
}

func parseCommit(text []byte) (written, error) {
	head, message, ok := strings.Cut(string(text), "\n\n")
	if !ok {
		return written{}, errors.New("the commit has no message")
	}
	found := written{message: message}
	for line := range strings.SplitSeq(head, "\n") {
		name, value, _ := strings.Cut(line, " ")
		switch name {
		case "tree":
			found.tree = value
		case "parent":
			found.parents = append(found.parents, value)
		case "author", "committer":
		default:
			return written{}, fmt.Errorf("the commit has %q, which nobody signed", name)
		}
	}
	return found, nil
}

// signed returns nil when the message is a statement that two registered people have signed, and that is not old.
func (w written) signed(repository string, registered signers, now time.Time) error {
	lines := strings.Split(w.message, "\n")
	if len(lines) < 4 || lines[1] != "" || lines[len(lines)-1] != "" || lines[0] == "" {
		return errors.New("the message must be a reason, a blank line, and the trailers that `robotkube break-glass sign` writes")
	}
	stamp, ok := strings.CutPrefix(lines[2], glassTrailer)
	at, err := time.Parse(timeForm, stamp)
	if !ok || err != nil {
		return fmt.Errorf("the message's first trailer must be `%s<time>`, such as %s", glassTrailer, timeForm)
	}
	statement := strings.Join([]string{
		"robotkube break-glass 1", "repository " + repository, "parent " + w.parents[0], "tree " + w.tree,
		"time " + stamp, "reason " + lines[0], "",
	}, "\n")
	names := map[string]bool{}
	trailers := lines[3 : len(lines)-1]
	if len(trailers) > signersMax {
		return fmt.Errorf("%d signatures; at most %d", len(trailers), signersMax)
	}
	for _, line := range trailers {
		value, ok := strings.CutPrefix(line, signedTrailer)
		name, signature, parts := strings.Cut(value, " ")
		if !ok || !parts {
			return fmt.Errorf("%q is no `%s<name> <signature>`", line, signedTrailer)
		}
		if len(registered[name]) == 0 {
			return fmt.Errorf("%q is none of the people in %s on main", name, signersFile)
		}
		if err := verify(signature, registered[name], statement); err != nil {
			return fmt.Errorf("signature of %s: %w", name, err)
		}
		names[name] = true
	}
	if len(names) < signersMin {
		return fmt.Errorf("signed by %d of the people in %s; %d different ones are needed", len(names), signersFile, signersMin)
	}
	if age := now.Sub(at); age > ageMax || age < -aheadMax {
		return fmt.Errorf("signed for %s, and it is %s here: that is not within %s; sign again", stamp, now.UTC().Format(timeForm), ageMax)
	}
	return nil
}

// verify checks an SSH signature (PROTOCOL.sshsig of OpenSSH) over the statement by one of the keys.
func verify(text string, keys []ed25519.PublicKey, statement string) error {
	data, err := base64.StdEncoding.DecodeString(text)
	if err != nil {
		return err
	}
	rest, ok := bytes.CutPrefix(data, []byte(sshsigMagic))
	if !ok || len(rest) < 4 || binary.BigEndian.Uint32(rest) != sshsigVersion {
		return errors.New("is no SSH signature")
	}
	read := &fields{data: rest[4:]}
	key, namespace, reserved, digest, signature := read.next(), read.next(), read.next(), read.next(), read.next()
	if !read.done() || string(namespace) != signatureOf || len(reserved) != 0 || string(digest) != signatureDigest {
		return fmt.Errorf("is none with namespace %s and %s", signatureOf, signatureDigest)
	}
	public, err := publicKey(base64.StdEncoding.EncodeToString(key))
	if err != nil {
		return err
	}
	inner := &fields{data: signature}
	kind, value := inner.next(), inner.next()
	if !inner.done() || string(kind) != ed25519Name || len(value) != ed25519.SignatureSize {
		return errors.New("is none by an ed25519 key")
	}
	hashed := sha512.Sum512([]byte(statement))
	message := []byte(sshsigMagic)
	for _, part := range [][]byte{namespace, reserved, digest, hashed[:]} {
		message = binary.BigEndian.AppendUint32(message, uint32(len(part)))
		message = append(message, part...)
	}
	for _, known := range keys {
		if known.Equal(public) && ed25519.Verify(known, message, value) {
			return nil
		}
	}
	return errors.New("is not over this commit, this tip, this repository, time and reason by a registered key of that name")
}

// fields reads strings with their length before them; after a mistake it gives nothing more and is never done.
type fields struct {
	data   []byte
	broken bool
}

func (f *fields) next() []byte {
	if len(f.data) < 4 {
		f.broken = true
		return nil
	}
	size := binary.BigEndian.Uint32(f.data)
	if uint64(size) > uint64(len(f.data)-4) {
		f.broken = true
		return nil
	}
	found := f.data[4 : 4+size]
	f.data = f.data[4+size:]
	return found
}

func (f *fields) done() bool { return !f.broken && len(f.data) == 0 }

// same says whether two commits have the same file at a path, or none.
func same(one, other, path string) bool {
	first, wrong := git("ls-tree", one, "--", path)
	second, also := git("ls-tree", other, "--", path)
	return wrong == nil && also == nil && bytes.Equal(first, second)
}

// object reads one object of git, of bounded size.
func object(kind, name string) ([]byte, error) {
	size, err := git("cat-file", "-s", name)
	if err != nil {
		return nil, err
	}
	if bytesHeld, err := strconv.Atoi(strings.TrimSpace(string(size))); err != nil || bytesHeld > objectBytesMax {
		return nil, fmt.Errorf("%s is longer than %d bytes", name, objectBytesMax)
	}
	return git("cat-file", kind, name)
}

// git runs git in the repository, where it sees what is being pushed.
func git(arguments ...string) ([]byte, error) {
	command := exec.Command("git", append([]string{"--no-replace-objects"}, arguments...)...)
	command.Stderr = io.Discard
	answer, err := command.Output()
	if err != nil {
		return nil, fmt.Errorf("git %s: %w", strings.Join(arguments, " "), err)
	}
	return answer, nil
}
