// Command chart-renderer renders charts as helm does, many in one process: helm's own start costs ten times what rendering one
// chart does. It reads one request per line and answers each with one line, in their order:
//
//	{"files": {"<path in the chart>": "<base64>"}, "values": {...}, "release": "...", "namespace": "..."}
//	{"objects": [...]}  or  {"problem": "..."}
//
// Objects are all that would be applied: of templates and of crds/, hooks included. What an object's document leaves open to
// more than one reading (a key that stands twice) is a problem. Before the first request it gives up the right to open
// files, to make sockets and to start programs, since a chart is somebody else's text.
package main

import (
	"bufio"
	"encoding/base64"
	"encoding/json"
	"errors"
	"fmt"
	"io"
	"log"
	"os"
	"regexp"
	"sort"
	"strings"

	"helm.sh/helm/v3/pkg/chart"
	"helm.sh/helm/v3/pkg/chart/loader"
	"helm.sh/helm/v3/pkg/chartutil"
	"helm.sh/helm/v3/pkg/engine"
	kubernetesyaml "k8s.io/apimachinery/pkg/util/yaml"
	"sigs.k8s.io/yaml"
)

// version is helm's, written by the linker.
var version = "unknown"

const (
	requestBytes = 64 << 20
	answerBytes  = 2 << 20
	notConfined  = 126
	notes        = "NOTES.txt"
)

// ended matches what follows the end of a document: some readers look at it, others do not.
var ended = regexp.MustCompile(`(?m)^\.\.\.\s+\S`)

// request is one chart, and what it shall be rendered with.
type request struct {
	Files     map[string]string `json:"files"`
	Values    map[string]any    `json:"values"`
	Release   string            `json:"release"`
	Namespace string            `json:"namespace"`
}

// answer has what came of a request: objects, or why there are none.
type answer struct {
	Objects []json.RawMessage `json:"objects,omitempty"`
	Problem string            `json:"problem,omitempty"`
}

func main() {
	if len(os.Args) == 2 && os.Args[1] == "--version" {
		fmt.Println("chart-renderer with helm", version)
		return
	}
	log.SetOutput(io.Discard) // helm warns of values there; the answer has what matters
	if err := confine(); err != nil {
		fmt.Fprintf(os.Stderr, "chart-renderer cannot be confined: %v\n", err)
		os.Exit(notConfined)
	}
	if err := serve(os.Stdin, os.Stdout); err != nil {
		fmt.Fprintf(os.Stderr, "chart-renderer: %v\n", err)
		os.Exit(1)
	}
}

// serve answers requests until there are no more.
func serve(in io.Reader, out io.Writer) error {
	lines := bufio.NewScanner(in)
	lines.Buffer(make([]byte, 0, 1<<16), requestBytes)
	for lines.Scan() {
		line, err := json.Marshal(answerTo(lines.Bytes()))
		if err != nil {
			return err
		}
		if _, err := out.Write(append(line, '\n')); err != nil {
			return err
		}
	}
	return lines.Err()
}

func answerTo(line []byte) (given answer) {
	defer func() {
		if fault := recover(); fault != nil {
			given = answer{Problem: fmt.Sprintf("rendering failed: %v", fault)}
		}
	}()
	objects, err := render(line)
	if err != nil {
		return answer{Problem: err.Error()}
	}
	return answer{Objects: objects}
}

func render(line []byte) ([]json.RawMessage, error) {
	var asked request
	if err := json.Unmarshal(line, &asked); err != nil {
		return nil, fmt.Errorf("the request: %w", err)
	}
	loaded, err := load(asked.Files)
	if err != nil {
		return nil, err
	}
	values, err := valuesOf(loaded, asked)
	if err != nil {
		return nil, err
	}
	texts, err := engine.Render(loaded, values)
	if err != nil {
		return nil, err
	}
	for _, definition := range loaded.CRDObjects() {
		texts[definition.Filename] = string(definition.File.Data)
	}
	return objectsOf(texts)
}

// load reads a chart from its files in memory.
func load(files map[string]string) (*chart.Chart, error) {
	var buffered []*loader.BufferedFile
	for name, text := range files {
		data, err := base64.StdEncoding.DecodeString(text)
		if err != nil {
			return nil, fmt.Errorf("%s: no base64: %w", name, err)
		}
		buffered = append(buffered, &loader.BufferedFile{Name: name, Data: data})
	}
	sort.Slice(buffered, func(i, j int) bool { return buffered[i].Name < buffered[j].Name })
	return loader.LoadFiles(buffered)
}

// valuesOf lays the given values over the chart's own, as an installation does. The schema is not looked at.
func valuesOf(loaded *chart.Chart, asked request) (chartutil.Values, error) {
	if asked.Values == nil {
		asked.Values = map[string]any{}
	}
	if err := chartutil.ProcessDependenciesWithMerge(loaded, asked.Values); err != nil {
		return nil, err
	}
	options := chartutil.ReleaseOptions{Name: asked.Release, Namespace: asked.Namespace, Revision: 1, IsInstall: true}
	return chartutil.ToRenderValuesWithSchemaValidation(loaded, asked.Values, options, nil, true)
}

// objectsOf reads the documents of rendered files, in the order of their names.
func objectsOf(texts map[string]string) ([]json.RawMessage, error) {
	names := make([]string, 0, len(texts))
	for name := range texts {
		if !strings.HasSuffix(name, notes) { // as helm tells notes; a name with _ hides a template from it, but nothing of crds/
			names = append(names, name)
		}
	}
	sort.Strings(names)
	objects := []json.RawMessage{}
	size := 0
	for _, name := range names {
		found, err := documents(texts[name])
		if err != nil {
			return nil, fmt.Errorf("%s: %w", name, err)
		}
		for _, object := range found {
			size += len(object)
		}
		if size > answerBytes {
			return nil, fmt.Errorf("the chart renders to more than %d bytes; make fewer or smaller objects", answerBytes)
		}
		objects = append(objects, found...)
	}
	return objects, nil
}

// documents reads the YAML documents of one file; empty ones are none.
func documents(text string) ([]json.RawMessage, error) {
	var objects []json.RawMessage
	reader := kubernetesyaml.NewYAMLReader(bufio.NewReader(strings.NewReader(text)))
	for {
		document, err := reader.Read()
		if errors.Is(err, io.EOF) {
			return objects, nil
		}
		if err != nil {
			return nil, err
		}
		object, err := yaml.YAMLToJSONStrict(document)
		if err != nil {
			return nil, err
		}
		if ended.Match(document) {
			return nil, errors.New("something follows the end of a document (...); begin the next one with ---")
		}
		if string(object) != "null" {
			objects = append(objects, object)
		}
	}
}
